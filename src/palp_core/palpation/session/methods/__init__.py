"""Methods in a session: what nodes report of them, and what a run has recorded of it."""
