"""What is solved: constraints, problem, and one module a solver."""
