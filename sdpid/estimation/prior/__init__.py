"""The prior: bodies, friction, and its strength."""
