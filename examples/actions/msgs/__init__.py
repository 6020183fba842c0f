"""Message types."""
