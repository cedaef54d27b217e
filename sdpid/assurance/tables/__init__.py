"""Audit published tables of base parameters."""
