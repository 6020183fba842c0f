"""The rig's topics as ROS 2's standard types, for ``palp bridge ros2`` and ``palp bag convert --types``.

Frames: x is the joint's axis, about which the torque acts; y points along the sweep, z up along the probe.
"""

from collections.abc import Iterator
from typing import Any

from msgs.actuator import RingState
from msgs.stage import StagePose
from msgs.torque import TorqueBlock
from palp_core.graph.ros2.maps import Times, to_ros2
from palp_core.graph.ros2.message_types import message_type

JointState = message_type("sensor_msgs/msg/JointState")
TFMessage = message_type("tf2_msgs/msg/TFMessage")
TransformStamped = message_type("geometry_msgs/msg/TransformStamped")
WrenchStamped = message_type("geometry_msgs/msg/WrenchStamped")

DEPTH = 1000
"""A block becomes a message for each sample, all at once."""


@to_ros2("/torque/block", "/torque/wrench", WrenchStamped, depth=DEPTH)
def torque_wrenches(block: TorqueBlock, times: Times) -> Iterator[tuple[int, Any]]:
    for at_ns, torque_n_m in _samples(block, block.torque_n_m):
        message = WrenchStamped()
        message.header.stamp, message.header.frame_id = times.to_ros2(at_ns), "probe"
        message.wrench.torque.x = torque_n_m
        yield at_ns, message


@to_ros2("/stage/pose", "/joint_states", JointState, depth=DEPTH)
def stage_joints(pose: StagePose, times: Times) -> Iterator[tuple[int, Any]]:
    for at_ns, position_m in _samples(pose, pose.position_m):
        yield at_ns, _joint(times.to_ros2(at_ns), "stage", position_m)


@to_ros2("/actuator/ring_state", "/joint_states", JointState)
def ring_joint(state: RingState, times: Times) -> Any:
    return _joint(times.to_ros2(state.stamp_ns), "ring", state.measured_m)


@to_ros2("/stage/pose", "/tf", TFMessage, depth=DEPTH)
def probe_frames(pose: StagePose, times: Times) -> Iterator[tuple[int, Any]]:
    for at_ns, position_m in _samples(pose, pose.position_m):
        message = _frame(times.to_ros2(at_ns), "world", "probe")
        message.transforms[0].transform.translation.y = position_m
        yield at_ns, message


@to_ros2("/actuator/ring_state", "/tf", TFMessage)
def ring_frame(state: RingState, times: Times) -> Any:
    message = _frame(times.to_ros2(state.stamp_ns), "probe", "ring")
    message.transforms[0].transform.translation.z = state.measured_m
    return message


def _samples(block: TorqueBlock | StagePose, values: Any) -> Iterator[tuple[int, float]]:
    for index, value in enumerate(values.tolist()):
        yield block.start_ns + round(index * 1e9 / block.rate_hz), value


def _joint(stamp: Any, name: str, position_m: float) -> Any:
    message = JointState(name=[name], position=[position_m])
    message.header.stamp = stamp
    return message


def _frame(stamp: Any, parent: str, child: str) -> Any:
    frame = TransformStamped(child_frame_id=child)
    frame.header.stamp, frame.header.frame_id = stamp, parent
    frame.transform.rotation.w = 1.0
    return TFMessage(transforms=[frame])
