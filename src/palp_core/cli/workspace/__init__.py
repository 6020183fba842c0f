"""``palp init`` and ``palp new``: a workspace, and what goes into it."""
