"""Simulated time in rounds."""
