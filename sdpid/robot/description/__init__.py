"""What the files that describe a robot say: URDF, MJCF, Denavit-Hartenberg tables."""
