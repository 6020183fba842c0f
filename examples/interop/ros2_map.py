"""What crosses between this graph and ROS 2: palp bridge ros2 examples/interop/ros2_map.py."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Any

from msgs.torque import Load, TareReply, TareRequest, TorqueBlock
from palp_core.graph.ros2.maps import Times, from_ros2, serve_ros2, share_parameters, to_ros2
from palp_core.graph.ros2.message_types import message_type

Float64 = message_type("std_msgs/msg/Float64")
WrenchStamped = message_type("geometry_msgs/msg/WrenchStamped")


@to_ros2("/sensor/torque", "/wrench", WrenchStamped)
def wrench(block: TorqueBlock, times: Times) -> Any:
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = times.to_ros2(block.stamp_ns), "probe"
    message.wrench.torque.x = block.torque_n_m[-1]
    return message


@to_ros2("/sensor/torque", "/torque_samples", Float64, depth=1000)
def samples(block: TorqueBlock) -> Iterator[tuple[int, Any]]:
    for torque_n_m in block.torque_n_m:
        yield block.stamp_ns, Float64(data=torque_n_m)


@from_ros2("/load", "/sensor/load", Float64, depth=1000)
def load(message: Any) -> Load:
    return Load(torque_n_m=message.data)


@serve_ros2("/sensor/tare", "/tare", "std_srvs/srv/Trigger")
def tare(_request: Any, response: Any) -> Generator[TareRequest, TareReply, Any]:
    reply = yield TareRequest()
    response.success, response.message = True, f"tared at {reply.offset_n_m:g} N m"
    return response


sensor_parameters = share_parameters("sensor")
