"""What noise in the motion, landings, the filter, and friction's law do to a fit."""
