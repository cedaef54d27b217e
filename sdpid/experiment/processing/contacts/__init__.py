"""Contacts of a robot with its surroundings, sample by sample."""
