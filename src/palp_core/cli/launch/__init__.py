"""Verbs that start or change a graph."""
