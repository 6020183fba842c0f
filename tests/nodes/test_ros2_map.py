"""The rig's map to ROS 2 over a recording of the rig: standard types of torque, stage and ring."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from msgs.actuator import RingState
from msgs.stage import StagePose
from msgs.torque import TorqueBlock
from palp_core.graph.bag.ros2.export_bag import write
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.message import Message, encode
from palp_core.graph.messages.topic import topic_of
from palp_core.graph.ros2.message_types import known_types
from palp_core.graph.ros2.plan import outlets_of

MS = 1_000_000


def recorded(folder: Path) -> Path:
    shown: dict[str, Message] = {
        "/torque/block": TorqueBlock(
            stamp_ns=5 * MS, start_ns=2 * MS, rate_hz=1000.0, over_phantom=True, saturated_count=0,
            torque_n_m=np.array([0.25, 0.5, 0.75]),
        ),
        "/stage/pose": StagePose(
            stamp_ns=5 * MS, goal_id=1, start_ns=2 * MS, rate_hz=1000.0, position_m=np.array([0.01, 0.02])
        ),
        "/actuator/ring_state": RingState(
            stamp_ns=5 * MS, trial=1, iteration=1, rehome=False, target_m=0.004, measured_m=0.0041,
            settled=True,
        ),
    }  # fmt: skip
    with BagWriter(folder) as bag:
        for name, message in shown.items():
            stream = bag.stream(Stream(topic=topic_of(name, type(message))))
            bag.write(stream, 1, 5 * MS, 5 * MS, encode(message))
    return folder


def test_the_rig_is_wrenches_joints_and_frames(tmp_path: Path) -> None:
    bag = recorded(tmp_path / "bag")
    assert write(bag, tmp_path / "ros", outlets_of("nodes.ros2_map", bag), known_types()) == 3 + 2 + 2 + 1 + 1
    store = get_typestore(Stores.ROS2_KILTED)
    found: dict[str, list[Any]] = {}
    with Reader(tmp_path / "ros") as ros:
        for connection, at_ns, data in ros.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((at_ns // MS, message))
    assert [(at, m.header.stamp.nanosec // MS, m.wrench.torque.x) for at, m in found["/torque/wrench"]] == [
        (2, 2, 0.25), (3, 3, 0.5), (4, 4, 0.75),
    ]  # fmt: skip
    joints = [(at, m.name, m.position.tolist()) for at, m in found["/joint_states"]]
    assert joints == [(2, ["stage"], [0.01]), (3, ["stage"], [0.02]), (5, ["ring"], [0.0041])]
    frames = [
        (at, t.child_frame_id, t.transform.translation.y) for at, m in found["/tf"] for t in m.transforms
    ]
    assert frames == [(2, "probe", 0.01), (3, "probe", 0.02), (5, "ring", 0.0)]
    assert {c.transforms[0].transform.rotation.w for _, c in found["/tf"]} == {1.0}
