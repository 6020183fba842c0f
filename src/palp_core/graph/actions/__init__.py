"""Goals that take time: what both ends of an action know of them, and no socket or node in sight."""
