"""Policies that choose more than the ring."""
