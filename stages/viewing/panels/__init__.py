"""Panels of the page, a module each, with `add(page)`."""
