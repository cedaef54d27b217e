"""Write robots: URDF and MJCF."""
