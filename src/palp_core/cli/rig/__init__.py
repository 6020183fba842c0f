"""Verbs that know palpation."""
