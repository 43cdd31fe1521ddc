"""From cameras and a field to images."""
