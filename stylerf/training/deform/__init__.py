"""Fitting a deformation to the photos (DeSRF, section 3.2)."""
