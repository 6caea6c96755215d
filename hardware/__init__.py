"""What touches a robot."""
