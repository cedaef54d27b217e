"""Where a robot touches its surroundings: Jacobians of contact points."""
