"""Robotic palpation: a node graph, the mechanics of a soft probe, and the perception of depth."""
