"""Audit robot descriptions."""
