"""Guards the base, simulated or real, from any controller: the velocity filter and what it believes."""
