"""Fine-tuning a field on edited photos (LAENeRF, section 3.5)."""
