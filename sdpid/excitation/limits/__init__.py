"""Limits of a motion, and the proof that a trajectory holds them at every instant."""
