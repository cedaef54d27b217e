"""How the rows of a result are made of its logs, as plain values."""
