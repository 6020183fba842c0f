"""``palp session``: sessions with people and operators, and what was decided about their trials."""
