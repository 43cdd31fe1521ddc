"""A field as 3D Gaussians: placed on its surfaces, then optimized against its own renders (Kerbl et al. 2023)."""
