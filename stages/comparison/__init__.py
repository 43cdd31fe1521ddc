"""Compare runs of one or more work folders: cost against quality."""
