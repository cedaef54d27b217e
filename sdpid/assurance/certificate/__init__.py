"""Certificates, and their check in exact arithmetic."""
