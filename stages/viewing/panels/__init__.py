"""Panels of the page, one module each, with `add(page)`: controls for the part of the desk that does the work."""
