"""Feature trunks, style losses, colour matching."""
