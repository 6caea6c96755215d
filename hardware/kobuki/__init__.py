"""The Kobuki base: its serial protocol, its odometry, its driver, and an emulator."""
