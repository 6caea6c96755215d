"""Recorded data sets for the SLAM estimator alone: their loaders, its run on them, and its errors."""
