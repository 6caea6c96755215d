"""The Kobuki base: its serial protocol, its odometry, a driver in a process of its own, and an emulator."""
