"""What stands between any controller and the base, simulated or real: the velocity filter and what it believes."""
