"""The one way to a graph: check it, start it, run it, end it."""
