"""Drivers of force and torque sensors."""
