"""Checks of measured contact forces: each leg is a free body between its foot and the base."""
