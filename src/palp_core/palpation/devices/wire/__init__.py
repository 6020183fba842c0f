"""Bytes of the devices' protocols: pure functions and tables, no link in sight."""
