"""Recordings of linkages: joints without motors, positions that loops close."""
