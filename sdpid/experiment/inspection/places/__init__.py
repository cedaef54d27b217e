"""Checks of where sensors sit on a base, and where feet touch the ground."""
