"""Figures of runs, comparisons and the paper, and what Meshcat shows: matplotlib and plain geometry, no Drake."""
