"""What they say to each other."""
