"""Scenes: what is simulated, and which model it takes."""
