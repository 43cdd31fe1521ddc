"""Optimization loops and their building blocks."""
