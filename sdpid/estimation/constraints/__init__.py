"""Constraints on the parameters, and the feasible set."""
