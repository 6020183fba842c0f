"""Drivers of the anchor ring's motor."""
