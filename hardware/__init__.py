"""Drivers of a robot."""
