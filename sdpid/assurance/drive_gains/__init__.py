"""Identify drive gains, N·m/A, from motor currents with and without a known load."""
