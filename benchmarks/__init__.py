"""Measurements: one command per table, results as JSON in results/."""
