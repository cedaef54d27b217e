"""How much a motion shows of the parameters: information and objectives of it."""
