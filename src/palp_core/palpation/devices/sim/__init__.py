"""Simulated devices: parameters are frozen, what changes is in a small state that the caller holds."""
