"""Drivers of EMG amplifiers."""
