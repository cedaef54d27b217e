"""Process a recording into `Samples`: filters, derivatives, gaps, periods."""
