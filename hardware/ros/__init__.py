"""TurtleBots over ROS: ROS 2 natively or through rosbridge, neither imported before it is used."""
