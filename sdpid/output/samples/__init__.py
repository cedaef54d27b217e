"""Draws of consistent robots, as files and as ranges for domain randomization."""
