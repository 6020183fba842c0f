"""From a launch file to a checked graph."""
