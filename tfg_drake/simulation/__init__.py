"""The simulated robot: motion with contact, odometry, tag sensor, laser scanner; and the filter before its base."""
