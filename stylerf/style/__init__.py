"""Feature trunks, style losses, color matching."""
