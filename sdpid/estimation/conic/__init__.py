"""Cone programs for Clarabel and SCS; they know no robot."""
