"""Read log files of many formats into a `Recording`."""
