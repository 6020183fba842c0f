"""A sample as a wrench, and back."""

from typing import Any

from msgs.torque import Sample
from palp_core.graph.ros2.maps import Times, from_ros2, to_ros2
from palp_core.graph.ros2.message_types import message_type

WrenchStamped = message_type("geometry_msgs/msg/WrenchStamped")


@to_ros2("/source/sample", "/torque_out", WrenchStamped, depth=1000)
def wrench(sample: Sample, times: Times) -> Any:
    message = WrenchStamped()
    message.header.stamp = times.to_ros2(times.stamp_ns)
    message.wrench.force.x, message.wrench.force.y = sample.index, sample.sent_ns
    message.wrench.torque.x = sample.torque_n_m
    return message


@from_ros2("/torque_in", "/sink/sample", WrenchStamped, depth=1000)
def sample(message: Any) -> Sample:
    force, torque = message.wrench.force, message.wrench.torque
    return Sample(index=force.x, sent_ns=force.y, torque_n_m=torque.x)
