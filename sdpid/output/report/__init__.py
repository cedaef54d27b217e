"""The report, and its verdict in words."""
