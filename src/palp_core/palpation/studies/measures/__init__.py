"""Contact models: speed, accuracy, and where they fail."""
