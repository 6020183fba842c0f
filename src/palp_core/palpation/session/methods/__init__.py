"""Methods in a session: what nodes say of them, what a run has recorded of it, and that in words."""
