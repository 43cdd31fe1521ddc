"""Convert a field to 3D Gaussians: placed on its surfaces, then optimized on its renders (Kerbl et al. 2023)."""
