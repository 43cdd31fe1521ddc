"""Benchmarks: one command per table, with results as JSON in results/."""
