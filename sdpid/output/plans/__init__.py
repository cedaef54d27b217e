"""Files of a plan: for controllers, for people, and to make it again."""
