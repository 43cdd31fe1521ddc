"""Image, consistency and style metrics."""
