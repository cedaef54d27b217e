"""What noise in the measured motion, and landings, do to a fit."""
