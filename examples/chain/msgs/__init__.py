"""Messages of the chain."""
