"""Occupancy grids: GMapping, and frontiers, goals and paths on its map. The baseline that the TFG is compared with."""
