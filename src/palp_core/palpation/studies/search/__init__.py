"""Speed against accuracy of searches in the plane."""
