"""Deliberate, measured faults of captures, photos and style images."""
