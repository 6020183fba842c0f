"""The server of the pages, and who is let in."""
