"""Confidence intervals of base and standard parameters."""
