"""The palpation rig: one file, one class, one process."""
