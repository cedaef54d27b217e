"""Estimates from the closed loop, which noise in the measured motion does not bias."""
