"""``palp init`` and ``palp new``: a workspace of one's own, and what goes into it."""
