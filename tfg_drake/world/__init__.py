"""Worlds: walls, tags and a start, from scenarios, occupancy grids or vector maps; and what of them can be reached."""
