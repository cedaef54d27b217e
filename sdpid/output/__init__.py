"""What is taken away: tables, robots, reports, plans."""
