"""Results folders, read back."""
