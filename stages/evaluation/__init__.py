"""Metrics of a field: definitions, masks, views, perceptual networks and camera paths."""
