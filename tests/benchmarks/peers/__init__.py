"""Peers whose own programs do not fit beside ours, written again from their papers.

None is slower than its published program on the same slices: `python -m
tests.benchmarks.published` runs both, given clones of the published ones.
"""
