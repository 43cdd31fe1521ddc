"""Shared by all training loops."""
