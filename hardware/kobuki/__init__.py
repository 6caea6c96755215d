"""The Kobuki base: its serial protocol, its odometry and its driver."""
