"""Stylizing a fitted field: ARF, DeSRF, SNeRF, Ref-NPR and PaletteNeRF."""
