"""Surfaces of radiance fields: isosurfaces of their density, what cameras see of them, and their colors."""
