"""What comes after what in a mission, and what an operator may ask of it."""
