"""What is wrong, and how it goes."""
