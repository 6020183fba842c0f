"""The torque sensor's nodes: the real one tares, reports every load and makes even blocks."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest

from msgs.torque import Contact
from nodes import rig_torque
from nodes.rig_torque import RigTorque
from nodes.torque import Torque
from palp_core import Bench
from palp_core.errors import DeviceError, NodeError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.health import Condition, DeviceHealth
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.palpation.devices.torque.ati import AtiState, AtiTorque
from palp_core.palpation.world.model import LAB
from palp_core.units import Float64Array

MS = 1_000_000


class ScriptedSensor:
    """Delivers what it is given."""

    state_type = AtiState

    def __init__(self) -> None:
        self.waiting: list[TorqueSamples] = []
        self.is_open = False
        self.condition = Condition.OK

    def open(self, *_: Any) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def health(self, now_ns: int) -> DeviceHealth:
        return DeviceHealth(self.condition, now_ns, "")

    def drain(self, now_ns: int, state: Any, rng: Any) -> TorqueSamples:
        return self.waiting.pop(0) if self.waiting else samples([], [])

    def tare(self, block: TorqueSamples, state: Any) -> Float64Array:
        return AtiTorque().tare(block, state)


def samples(times_ms: list[float], torque: list[float], **counts: Any) -> TorqueSamples:
    wrench = np.zeros((len(times_ms), 6))
    wrench[:, 3] = torque
    wrench[:, 1] = 2.0
    return TorqueSamples(
        (np.array(times_ms) * MS).astype(np.int64),
        np.array(torque, dtype=float),
        counts.get("saturated", 0),
        gap=np.zeros(len(times_ms), dtype=bool),
        faulty=counts.get("faulty", np.zeros(len(times_ms), dtype=bool)),
        wrench=wrench,
    )


@pytest.fixture
def sensor(monkeypatch: pytest.MonkeyPatch) -> ScriptedSensor:
    scripted = ScriptedSensor()
    monkeypatch.setattr(rig_torque, "open_device", lambda *_, **__: scripted)
    return scripted


def test_it_tares_before_it_says_anything(sensor: ScriptedSensor) -> None:
    bench = Bench(RigTorque, {"tare_samples": 4})
    sensor.waiting = [samples([1, 2], [0.01, 0.03]), samples([3, 4], [0.01, 0.03])]
    bench.advance(0.0015)
    assert bench.sent(RigTorque.load) == []
    bench.advance(0.001)
    assert bench.node.state.device.bias[3] == pytest.approx(0.02)
    assert bench.node.state.device.bias[1] == pytest.approx(2.0)
    bench.advance(0.001)
    assert len(bench.sent(RigTorque.load)) == 1


def test_a_tare_over_bad_samples_is_done_again(sensor: ScriptedSensor) -> None:
    bench = Bench(RigTorque, {"tare_samples": 2})
    sensor.waiting = [
        samples([1, 2], [0.1, 0.1], faulty=np.array([False, True])),
        samples([3, 4], [0.01, 0.03]),
    ]
    bench.advance(0.0015)
    assert not bench.node.state.tared
    bench.advance(0.001)
    assert bench.node.state.tared
    assert bench.node.state.device.bias[3] == pytest.approx(0.02)


def streaming(**params: Any) -> Bench[RigTorque]:
    return Bench(RigTorque, {"tare": "never", **params})


@pytest.mark.parametrize(("sent_hz", "published"), [(200, 1), (950, 0), (1000, 0)])
def test_a_sensor_of_another_rate_than_its_samples_are_timed_by_is_reported_once(
    sent_hz: int, published: int, sensor: ScriptedSensor, caplog: pytest.LogCaptureFixture
) -> None:
    bench = streaming(load_hz=50.0)
    sensor.waiting = [samples(list(range(sent_hz // 50)), [0.0] * (sent_hz // 50)) for _ in range(300)]
    with caplog.at_level(logging.WARNING):
        bench.advance(5.0)
    words = f"about {sent_hz} samples come a second, and rate_hz is 1000"
    assert sum(words in line for line in caplog.messages) == published
    assert sum("samples come a second" in line for line in caplog.messages) == published


def test_every_load_is_reported_at_once_with_its_largest_values(sensor: ScriptedSensor) -> None:
    bench = streaming()
    sensor.waiting = [samples([0.2, 0.7], [0.01, -0.05])]
    bench.advance(0.001)
    report = next(report for report in bench.sent(RigTorque.load) if report.sample_count)
    assert report.torque_n_m == pytest.approx(0.05)
    assert report.force_n == pytest.approx(2.0)
    assert report.sample_ns == 700_000


def test_silence_is_reported_too_and_the_last_sample_stays_old(sensor: ScriptedSensor) -> None:
    bench = streaming()
    sensor.waiting = [samples([0.5], [0.01])]
    bench.advance(0.010)
    reports = bench.sent(RigTorque.load)
    assert len(reports) >= 10
    assert {report.sample_ns for report in reports[2:]} == {500_000}


@pytest.mark.parametrize("condition", Condition)
def test_the_devices_condition_is_reported_with_every_load(
    sensor: ScriptedSensor, condition: Condition
) -> None:
    bench = streaming()
    sensor.condition = condition
    bench.advance(0.001)
    assert bench.sent(RigTorque.load)[-1].condition == condition.value


def test_a_value_that_is_no_number_is_faulty_and_in_no_block(sensor: ScriptedSensor) -> None:
    bench = streaming(block_samples=3)
    sensor.waiting = [samples([1, 2, 3, 4], [0.01, float("nan"), 0.02, 0.03])]
    bench.advance(0.002)
    assert sum(report.faulty_count for report in bench.sent(RigTorque.load)) == 1
    assert all(np.all(np.isfinite(block.torque_n_m)) for block in bench.sent(RigTorque.block))


def test_saturated_samples_are_counted(sensor: ScriptedSensor) -> None:
    bench = streaming()
    sensor.waiting = [samples([1, 2], [0.12, 0.12], saturated=2, faulty=np.array([True, True]))]
    bench.advance(0.001)
    assert sum(report.saturated_count for report in bench.sent(RigTorque.load)) == 2
    assert sum(report.faulty_count for report in bench.sent(RigTorque.load)) == 0


def test_every_sample_across_a_fault_and_to_the_end_is_passed_on_once_at_its_time(
    sensor: ScriptedSensor,
) -> None:
    bench = streaming(block_samples=20)
    times_ms = [*range(1, 36), *range(60, 95), *range(500, 507)]  # a fault of 25 ms, one of 0.4 s
    values = [1e-3 * k for k in range(len(times_ms))]
    parts = [(0, 7), (7, 30), (30, 36), (36, 70), (70, 74)]
    sensor.waiting = [samples(times_ms[a:b], values[a:b]) for a, b in parts]
    bench.advance(0.1)
    sensor.waiting = [samples(times_ms[74:], values[74:])]  # came after the last tick
    bench.executor.transition(Transition.DEACTIVATE)
    blocks = bench.sent(RigTorque.block)
    given = [value for block in blocks for value in block.torque_n_m.tolist()]
    assert given == values
    assert not any(block.over_phantom for block in blocks)
    assert blocks[0].rate_hz == pytest.approx(1000.0)
    starts_ms = [block.start_ns / MS for block in blocks]
    ends_ms = [block.start_ns / MS + 1e3 * (len(block.torque_n_m) - 1) / block.rate_hz for block in blocks]
    assert starts_ms == sorted(starts_ms)
    assert {1.0, 60.0, 500.0} <= set(starts_ms)
    assert {35.0, 94.0, 506.0} <= {round(end_ms, 6) for end_ms in ends_ms}
    assert not sensor.is_open


@pytest.mark.parametrize(
    ("params", "shown"),
    [
        ({}, ""),
        ({"block_samples": 50}, "the torque comes in blocks of 0.05 s: a sample is up to 0.0593 s old"),
        ({"load_hz": 200.0}, "the load comes in blocks of 0.005 s: a sample is up to 0.0096 s old"),
    ],
)
def test_blocks_and_loads_that_come_late_are_reported_at_the_start(
    sensor: ScriptedSensor, caplog: pytest.LogCaptureFixture, params: dict[str, Any], shown: str
) -> None:
    with caplog.at_level(logging.WARNING):
        Bench(RigTorque, params)
    assert [shown in record.getMessage() for record in caplog.records] == ([True] if shown else [])


def test_a_sensor_that_cannot_be_opened_is_not_drained(
    sensor: ScriptedSensor, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: Any) -> None:
        raise DeviceError("no such port")

    def never(*_: Any) -> None:
        raise AssertionError("drained, and it is not open")

    monkeypatch.setattr(sensor, "open", refuse)
    monkeypatch.setattr(sensor, "drain", never)
    with pytest.raises(NodeError, match="no such port"):
        Bench(RigTorque)
    assert "a hook failed" not in caplog.text


STEP_N_M = 1e-3 / 64


def contact(torque_n_m: Float64Array, start_ns: int = 5_000_000) -> Contact:
    return Contact(stamp_ns=0, goal_id=1, start_ns=start_ns, rate_hz=1000.0, torque_n_m=torque_n_m)


def test_nothing_is_measured_while_nothing_is_swept() -> None:
    bench = Bench(Torque)
    bench.advance(60.0)
    assert bench.sent(Torque.block) == []
    assert bench.executor.next_due_ns() is None


def test_in_the_labs_world_the_zero_walks_where_no_walk_is_given() -> None:
    def ends(**params: object) -> Float64Array:
        bench = Bench(Torque, params, seed=2)
        for second in (0, 4000):
            bench.feed(Torque.contact, contact(np.zeros(50), start_ns=second * 1_000_000_000))
        return bench.sent(Torque.block)[-1].torque_n_m

    own = LAB.bias_walk_n_m_per_sqrt_s * 1e3
    np.testing.assert_array_equal(ends(world="lab"), ends(bias_drift_n_mm_per_sqrt_s=own))
    given = {"bias_drift_n_mm_per_sqrt_s": 3 * own}
    np.testing.assert_array_equal(ends(world="lab", **given), ends(**given))
    assert abs(ends(world="lab").mean() - ends().mean()) > 2 * STEP_N_M
