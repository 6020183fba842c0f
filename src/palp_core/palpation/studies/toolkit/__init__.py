"""What studies share: processes, kept results, progress."""
