"""Whiten the rows of a problem and compress them into a triangular factor."""
