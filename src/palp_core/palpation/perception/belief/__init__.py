"""Depth as a posterior: likelihoods, filters, stop rules."""
