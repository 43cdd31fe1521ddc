"""Training the palette module of a local edit (LAENeRF)."""
