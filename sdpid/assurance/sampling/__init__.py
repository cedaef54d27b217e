"""Draws of consistent robots from what data, prior and constraints say together."""
