"""Identify what is mounted on the last link."""
