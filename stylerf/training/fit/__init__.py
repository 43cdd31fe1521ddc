"""Fitting a radiance field to posed photos."""
