"""What was measured: excitation, simulated plant, recordings, processing."""
