"""Recordings as the source of a graph, and nodes driven again from them."""
