"""Friction and drive terms, and their columns in the regressor."""
