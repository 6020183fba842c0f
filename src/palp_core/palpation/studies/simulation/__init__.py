"""Whole sessions without a graph, many at a time."""
