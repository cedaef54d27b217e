"""Robots on legs: motions, plants and what their sensors record."""
