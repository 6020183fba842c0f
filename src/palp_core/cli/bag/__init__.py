"""``palp bag``."""
