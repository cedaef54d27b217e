"""Motion of a robot whose parameters are known, to be compared with logs."""
