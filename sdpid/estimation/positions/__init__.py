"""Fit drives to the positions of a robot that a known law moves."""
