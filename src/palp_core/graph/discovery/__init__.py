"""How a running graph is found and asked."""
