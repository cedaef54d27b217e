"""The plan: a motion, its limits and what it will buy."""
