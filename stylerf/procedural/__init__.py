"""Procedural scenes and paintings with known ground truth."""
