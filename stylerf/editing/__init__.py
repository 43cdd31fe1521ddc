"""Local edits: regions of a scene, their appearance in the views, and palettes (LAENeRF, Radl et al. 2024)."""
