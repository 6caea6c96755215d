"""The topological feature graph: landmarks joined by obstacle surfaces, free star polygons, frontiers."""
