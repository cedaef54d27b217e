"""The semidefinite program: the proven global optimum."""
