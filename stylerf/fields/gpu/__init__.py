"""Fields on a GPU."""
