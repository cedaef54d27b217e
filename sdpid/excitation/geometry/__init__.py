"""Shapes of links and obstacles, and the distances between them."""
