"""Whether a claim holds elsewhere."""
