"""The proof from the log: rows, compression and bound, recomputed from what the robot wrote."""
