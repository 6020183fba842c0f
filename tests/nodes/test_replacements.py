"""A replacement of any node goes on byte for byte where its predecessor stood, drawn numbers and all."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from msgs.actuator import RingTruth
from msgs.emg import EmgBlock
from msgs.stage import StagePose, SweepGoal
from msgs.torque import Contact
from nodes.actuator import Actuator
from nodes.cocontraction import Cocontraction
from nodes.emg import Emg
from nodes.emulated_phantom import EmulatedPhantom
from nodes.operator import Operator
from nodes.phantom import Phantom
from nodes.rig_actuator import RigActuator
from nodes.rig_stage import RigStage
from nodes.rig_torque import RigTorque
from nodes.safety import Safety
from nodes.stage import Stage
from nodes.torque import Torque
from palp_core import Bench, Node
from palp_core.graph.node.node import declaration_of
from palp_core.graph.node.params import describe_params
from tests.support.kept import replace, sent_bytes
from tests.support.rig_messages import mount, ring_command

Feed = Callable[[Bench[Any]], None]
PATH_M = np.linspace(-0.03, 0.05, 401)
GOAL = SweepGoal(stamp_ns=0, goal_id=1, from_m=-0.03, to_m=0.05)


def wait(seconds: float) -> Feed:
    return lambda bench: bench.advance(seconds)


def feed(port: Any, *messages: Any) -> Feed:
    return lambda bench: bench.feed(port, *messages)


def contact(start_ns: int) -> Feed:
    felt = Contact(stamp_ns=0, goal_id=1, start_ns=start_ns, rate_hz=1000.0, torque_n_m=np.zeros(200))
    return feed(Torque.contact, felt)


def muscles(begin_s: float, end_s: float) -> Feed:
    """Feed the simulated muscles' blocks of a span of time."""

    def feed_blocks(bench: Bench[Any]) -> None:
        blocks = [block for block in recorded() if begin_s * 1e9 <= block.start_ns < end_s * 1e9]
        bench.feed(Cocontraction.emg, *blocks)

    return feed_blocks


@functools.cache
def recorded() -> list[EmgBlock]:
    source = Bench(Emg, seed=4)
    source.advance(16.0)
    return source.sent(Emg.block)


POSE = StagePose(stamp_ns=0, goal_id=9, start_ns=0, rate_hz=100.0, position_m=PATH_M)
RING = RingTruth(stamp_ns=0, trial=0, iteration=1, ring_m=0.016)
CASES: list[tuple[type[Node], dict[str, Any], list[Feed], list[Feed]]] = [
    (Stage, {}, [feed(Stage.goal, GOAL), wait(4.3)], [wait(20.0)]),
    (
        Actuator,
        {},
        [
            feed(Actuator.ring, ring_command(0.0, rehome=True)),
            feed(Actuator.command, ring_command(0.012)),
            wait(0.3),
        ],
        [wait(20.0), feed(Actuator.command, ring_command(0.012, iteration=2))],
    ),
    (Torque, {"bias_drift_n_mm_per_sqrt_s": 0.5}, [contact(5_000_000)], [contact(300_000_000)]),
    (
        Phantom,
        {},
        [feed(Phantom.mount, mount("A")), feed(Phantom.ring, RING), feed(Phantom.pose, POSE)],
        [feed(Phantom.pose, POSE), feed(Phantom.mount, mount("A", 1))],
    ),
    (
        Phantom,
        {"world": "lab"},
        [feed(Phantom.mount, mount("A")), feed(Phantom.ring, RING), feed(Phantom.pose, POSE)],
        [feed(Phantom.pose, POSE)],
    ),
    (Emg, {"palpation_s": 2.0}, [wait(9.73)], [wait(10.0)]),
    (Cocontraction, {}, [muscles(0.0, 12.5)], [muscles(12.5, 16.0)]),
]


@pytest.mark.parametrize(
    ("node", "changeable"),
    [
        (Stage, "rate_hz block_samples"),
        (RigStage, "rate_hz block_samples"),
        (Actuator, ""),
        (RigActuator, ""),
        (Torque, ""),
        (RigTorque, "load_hz block_samples tare tare_samples largest_gap_ms"),
        (Emg, "block_samples"),
        (Phantom, ""),
        (EmulatedPhantom, ""),
        (Operator, ""),
        (Safety, ""),
    ],
)
def test_what_would_change_without_effect_cannot_be_changed(node: type[Node], changeable: str) -> None:
    described = describe_params(declaration_of(node).params)
    assert [name for name, param in described.items() if not param.read_only] == changeable.split()


@pytest.mark.parametrize(
    ("node", "params", "before", "after"), CASES, ids=[case[0].__name__ for case in CASES]
)
def test_a_replacement_goes_on_byte_for_byte(
    node: type[Node], params: dict[str, Any], before: list[Feed], after: list[Feed]
) -> None:
    whole, first = Bench(node, params), Bench(node, params)
    for bench in (whole, first):
        for step in before:
            step(bench)
    second = replace(first)
    for bench in (whole, second):
        for step in after:
            step(bench)
    assert sent_bytes(second)
    assert sent_bytes(first) + sent_bytes(second) == sent_bytes(whole)
    assert second.executor.next_due_ns() == whole.executor.next_due_ns()
