"""ROS 2's messages as plain values and back: by their definitions, through ``rosbags``, without ROS."""
