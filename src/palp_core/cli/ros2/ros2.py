"""``palp ros2``: a running graph beside ROS 2."""

from palp_core.cli.lazy import Verb, lazy_app

app = lazy_app(
    "A running graph beside ROS 2.",
    {
        "bridge": Verb(
            "palp_core.cli.ros2.bridge:bridge",
            "Let topics, services and parameters cross between a running graph and ROS 2, as a map says.",
        )
    },
)
