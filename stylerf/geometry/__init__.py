"""Cameras, rays, warps and camera paths."""
