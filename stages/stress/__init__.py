"""Stress tests: faults, success criteria, trials, success rates, baselines."""
