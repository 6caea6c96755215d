"""Recordings of ports, timelines, trajectories, and runs as arrays."""
