"""Two estimates of one robot, against each other."""
