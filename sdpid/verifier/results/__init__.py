"""Check a results folder: manifest, tables of parameters, and robots in URDF and MJCF."""
