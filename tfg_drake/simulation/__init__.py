"""The simulated robot: motion with contact, odometry, tag sensor, laser scanner, people."""
