"""What to run on the robot: motions that are safe at every instant and show the parameters."""
