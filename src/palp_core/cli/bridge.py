"""``palp bridge``: ways from a running graph into other programs."""

from palp_core.cli.lazy import Verb, lazy_app

app = lazy_app(
    {
        "foxglove": Verb(
            "palp_core.cli.foxglove:foxglove", "Show topics, log, parameters and services in Foxglove."
        ),
        "ros2": Verb(
            "palp_core.cli.ros2.bridge:bridge", "Exchange topics, services and parameters with ROS 2."
        ),
    }
)
