"""Nodes of the interop example."""
