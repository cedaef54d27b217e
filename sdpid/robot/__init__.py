"""What moves: kinematics, inertia algebra, friction terms, base parameters."""
