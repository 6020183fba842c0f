"""Another class in the place of a running node."""
