"""Quantities of the real rig, from its recordings."""
