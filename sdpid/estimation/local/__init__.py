"""Local solvers, to be compared with the global optimum."""
