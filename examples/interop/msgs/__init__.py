"""Messages of the interop example."""
