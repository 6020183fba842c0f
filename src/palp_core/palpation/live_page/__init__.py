"""The page of the rig in ``palp view``: what it shows as plain data, from messages; ``drawing`` shows it."""
