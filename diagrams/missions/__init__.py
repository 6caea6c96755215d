"""A mission run to its end, its folder and report; many of them compared."""
