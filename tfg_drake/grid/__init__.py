"""The grid baselines: exploration on an occupancy grid instead of a topological feature graph."""
