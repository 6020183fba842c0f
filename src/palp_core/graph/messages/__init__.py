"""What one message is: its type, its bytes, its frame."""
