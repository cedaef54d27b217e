"""Charts that a page draws itself, with all their samples."""
