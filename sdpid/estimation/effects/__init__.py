"""Friction curves whose shape is chosen by the data."""
