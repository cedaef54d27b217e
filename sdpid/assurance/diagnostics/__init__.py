"""Residuals, validation, provenance, active constraints, the mass matrix."""
