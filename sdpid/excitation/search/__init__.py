"""The search for the motion that shows most within the limits."""
