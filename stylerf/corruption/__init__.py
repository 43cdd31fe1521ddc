"""Controlled faults of captures, photos and style images."""
