"""The robot in three dimensions on a page: links, inertia ellipsoids, and a player."""
