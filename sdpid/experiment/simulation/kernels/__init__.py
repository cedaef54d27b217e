"""Compiled inner loops of the simulation: plain Python where Numba is missing."""
