"""Radiance fields: a density part, a color part, a space warp, an optional deformation."""
