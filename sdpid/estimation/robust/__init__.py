"""Robust losses."""
