"""An arm, and whoever sends it."""
