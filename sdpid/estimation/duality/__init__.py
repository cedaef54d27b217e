"""Multipliers, and the lower bounds that they prove."""
