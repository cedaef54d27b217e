"""What is taken away: comparison, export, plots."""
