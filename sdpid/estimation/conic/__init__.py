"""Cone programs for Clarabel; they know no robot."""
