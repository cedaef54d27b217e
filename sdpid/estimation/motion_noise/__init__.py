"""What noise in the measured motion, landings, and friction's law do to a fit."""
