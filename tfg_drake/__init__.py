"""Active SLAM on topological feature graphs. This layer never imports Drake."""

__version__ = "0.1.0"
