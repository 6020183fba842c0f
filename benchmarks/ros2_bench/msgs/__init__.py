"""Messages of the bench."""
