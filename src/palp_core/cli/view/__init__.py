"""``palp view``."""
