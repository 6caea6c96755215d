"""Robots that are not there, to try the real drivers against."""
