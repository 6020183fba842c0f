"""From a launch file to running processes: check, supervise, conduct, end."""
