"""What logs hold of a floating base and its contacts: found, checked and put together."""
