"""Design the excitation of a robot."""
