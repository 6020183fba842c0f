"""From a torque trace to a feature."""
