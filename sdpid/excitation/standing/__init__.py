"""What a standing robot on legs is to do: motions of its base over feet that stay in place."""
