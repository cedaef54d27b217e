"""Read robot descriptions: URDF, xacro, MJCF, Denavit-Hartenberg tables, and names of robots."""
