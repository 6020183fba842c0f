"""A chain of three nodes: the smallest graph that shows everything."""
