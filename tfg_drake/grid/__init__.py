"""The grid baseline: GMapping, a Rao-Blackwellised particle filter over occupancy grids. No Drake."""
