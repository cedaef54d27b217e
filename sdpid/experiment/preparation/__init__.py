"""Prepare recordings for a robot: joints, units, defaults, several logs."""
