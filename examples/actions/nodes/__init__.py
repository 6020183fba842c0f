"""An arm and the node that sends it."""
