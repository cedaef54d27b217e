"""What a motion will buy: expected intervals, bands and open directions."""
