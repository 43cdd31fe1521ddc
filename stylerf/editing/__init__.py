"""Local edits: regions of a scene, what the views show of them, and palettes (LAENeRF, Radl et al. 2024)."""
