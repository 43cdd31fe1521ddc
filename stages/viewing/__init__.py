"""The browser viewer: what is shown and edited, its pictures, its runs, and the page."""
