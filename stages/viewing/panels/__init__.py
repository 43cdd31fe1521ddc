"""Panels of the page, a module each, with `add(page)`: controls around the part of the desk that does the work."""
