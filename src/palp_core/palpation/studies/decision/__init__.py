"""Decisions: speed, accuracy, and where they fail."""
