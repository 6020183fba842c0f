"""Verbs about topics."""
