"""One experiment, from row to report."""
