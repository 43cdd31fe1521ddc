"""The HTML pages, charts and tables of eval, compare and stress."""
