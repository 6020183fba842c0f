"""Nodes of the benchmark."""
