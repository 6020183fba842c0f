"""A session's sheet, ``session.yaml``: who ran it, on whom, on what, and by which approval."""
