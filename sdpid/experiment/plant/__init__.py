"""Simulate the closed-loop experiment."""
