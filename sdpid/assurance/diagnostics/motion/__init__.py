"""What an estimate means for simulated motion."""
