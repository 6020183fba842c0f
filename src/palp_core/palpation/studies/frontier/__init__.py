"""Decisions by feature and by whole trace, in the paper's world and in a harder one."""
