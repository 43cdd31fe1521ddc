"""Feature extractors, style losses, color matching."""
