"""The verbs that deal with ROS 2."""
