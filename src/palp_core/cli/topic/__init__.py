"""``palp topic`` and ``palp tap``."""
