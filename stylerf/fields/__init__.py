"""Radiance fields: a density part, a colour part, a space warp, an optional deformation."""
