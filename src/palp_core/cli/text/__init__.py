"""Messages as text."""
