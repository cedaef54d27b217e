"""Checks of recordings with a floating base: orientation, velocities, IMU, feet, delays."""
