"""Slow and independent solvers of the same problem: what the fast one is held against."""
