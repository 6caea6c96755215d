"""Recorded data sets for the SLAM estimators alone: their loaders, a run on them, and its errors."""
