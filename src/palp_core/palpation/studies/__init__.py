"""Studies: the paper again, and beyond it."""
