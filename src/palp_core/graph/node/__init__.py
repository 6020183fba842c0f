"""What a node is, and what drives its handlers."""
