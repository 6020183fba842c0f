"""Nodes of the experiment with a person."""
