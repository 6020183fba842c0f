"""The bridge between a running graph and ROS 2: topics, services and parameters, by a map."""
