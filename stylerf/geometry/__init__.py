"""Cameras, rays, space warps and camera paths."""
