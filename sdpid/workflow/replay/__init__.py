"""Run a recipe again from its logs and its robot, and compare a folder of results with it."""
