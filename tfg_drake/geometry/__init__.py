"""Planar geometry: poses, visibility, distances, polygons."""
