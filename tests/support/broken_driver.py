"""A driver whose module fails while it is imported."""

RATE_HZ = 1 / 0
