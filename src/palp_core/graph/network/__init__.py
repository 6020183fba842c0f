"""Graphs that reach beyond one host."""
