"""The legs of a robot: its feet, the joints that carry them, and the pose in which it stands."""
