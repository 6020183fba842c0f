"""A running graph beside ROS 2: topics, services and parameters both ways, as a map file says."""
