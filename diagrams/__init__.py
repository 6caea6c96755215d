"""Diagrams, scenarios and the commands."""
