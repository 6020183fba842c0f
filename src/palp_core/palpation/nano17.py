"""What the maker states of the torque sensor, an ATI Nano17 with calibration SI-12-0.12."""

RESOLUTION_N_M = 1e-3 / 64
"""Step of a torque (the paper's figure: 0.015 N mm)."""
FORCE_RESOLUTION_N = 1.0 / 320
"""Step of a force."""
RANGE_N_M = 0.120
"""Largest torque."""
RANGE_N = 12.0
"""Largest force."""
