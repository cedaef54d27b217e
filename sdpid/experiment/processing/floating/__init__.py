"""Process a recording with a floating base: its accelerations, and contacts within the filter."""
