"""Worlds: walls, tags and a start, made from scenarios, occupancy grids and vector maps; and what of them can be reached."""
