"""Pretrained network weights: where they are found and how each format is read."""
