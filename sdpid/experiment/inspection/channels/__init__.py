"""Single channels of single joints: what no other joint and no description is needed for."""
