"""What noise in the measured motion does to a fit: the same noise once more."""
