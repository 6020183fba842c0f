"""The one door to a graph: check it, start it, run it, end it."""
