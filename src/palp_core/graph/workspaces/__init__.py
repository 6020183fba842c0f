"""Workspaces that are installed under the one that one is in, and how their modules are found."""
