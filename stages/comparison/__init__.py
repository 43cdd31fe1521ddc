"""Runs of one or more work folders beside each other: what each cost, and how good it is."""
