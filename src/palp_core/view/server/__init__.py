"""The server of the pages, and its access check."""
