"""Sequence of a mission's phases, and requests of its operator."""
