"""``palp session``, ``sessions``: sheets, people, operators, decisions about trials, many sessions."""
