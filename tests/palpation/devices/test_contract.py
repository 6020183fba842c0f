"""What every device promises, simulated, emulated or real (``--hardware CONFIG``).

CONFIG is a file as ``docs/hardware.yaml``. With it the stage **moves** up to 20 mm about y = 0 and the ring
up to 10 mm, and only if the file says that they may.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from typing import Any

import msgspec
import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices import open_device
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.registry import BACK_ENDS
from tests.support.hardware import Hardware

pytestmark = pytest.mark.filterwarnings("default::palp_core.palpation.devices.unverified.UnverifiedWarning")
BY_KIND = {kind: list(names) for kind, names in BACK_ENDS.items()}
SIM_OPTIONS: dict[str, dict[str, Any]] = {"emg": {"matrix": [[0.2] * 5] * 5}, "stage": {"lift_m": 0.002}}
EMULATED_OPTIONS: dict[str, dict[str, Any]] = {  # slow: what is predicted or cut short has seconds of time
    "stage": {"lift_m": 0.002, "sweep_speed_m_per_s": 0.001, "return_speed_m_per_s": 0.005},
    "ring": {"speed_m_per_s": 1.25e-3},
}


@dataclass
class Subject:
    """A device under test with its state and its time."""

    kind: str
    name: str
    options: dict[str, Any]
    wait: Any
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    sim_ns: int = 0
    device: Any = None
    state: Any = None

    def __post_init__(self) -> None:
        self.device = self.make()
        self.state = self.device.state_type()

    def make(self) -> Any:
        return open_device(self.kind, self.name, **self.options)  # type: ignore[call-overload]

    def now(self) -> int:
        return self.sim_ns if self.name == "sim" else time.monotonic_ns()

    def open(self) -> Any:
        self.device.open(self.now(), self.state, self.rng)
        return self.device

    def reach(self, at_ns: int) -> None:
        """Let the time come."""
        if self.name == "sim":
            self.sim_ns = max(self.sim_ns, at_ns)
        else:
            self.wait.until(lambda: time.monotonic_ns() >= at_ns)

    def collect(self, count: int) -> list[Any]:
        """Drain blocks until there are so many samples."""
        blocks: list[Any] = []

        def enough() -> bool:
            self.sim_ns += 10_000_000
            blocks.append(self.device.drain(self.now(), self.state, self.rng))
            return sum(len(block.times_ns) for block in blocks) >= count

        self.wait.until(enough)
        return [block for block in blocks if len(block.times_ns)]


def every(*kinds: str) -> pytest.MarkDecorator:
    """Run a test on every device of some kinds."""
    without_lsl = pytest.mark.skipif(find_spec("pylsl") is None, reason="needs palp-core[lsl]")
    return pytest.mark.parametrize(
        "subject",
        [
            pytest.param((kind, name), id=f"{kind}-{name}", marks=[without_lsl] if name == "lsl" else [])
            for kind in kinds
            for name in [*BY_KIND[kind], "hardware"]
        ],
        indirect=True,
    )


@pytest.fixture
def subject(
    request: pytest.FixtureRequest,
    quick_rig: Callable[..., EmulatedRig],
    hardware: dict[str, Hardware],
    patient: dict[str, dict[str, Any]],
    wait: Any,
) -> Iterator[Subject]:
    kind, name = request.param
    if name == "hardware":
        if kind not in hardware:
            pytest.skip("not in --hardware")
        made = Subject(kind, hardware[kind].device, hardware[kind].options, wait)
    elif name == "sim":
        made = Subject(kind, name, SIM_OPTIONS.get(kind, {}), wait)
    else:
        options = quick_rig(name).options[name] | patient[name] | EMULATED_OPTIONS.get(kind, {})
        made = Subject(kind, name, options, wait)
    yield made
    made.device.close()


@every("stage", "ring", "torque", "emg")
def test_an_open_device_is_well_and_closing_it_twice_is_harmless(subject: Subject) -> None:
    device = subject.open()
    assert device.health(subject.now()).ok
    device.close()
    device.close()
    if subject.name != "sim":
        assert device.health(subject.now()).condition is Condition.CLOSED


@every("stage", "ring", "torque", "emg")
def test_a_successor_goes_on_with_the_state(subject: Subject) -> None:
    subject.open()
    if subject.kind in ("torque", "emg"):
        subject.collect(20)
    subject.device.close()
    state = msgspec.msgpack.decode(msgspec.msgpack.encode(subject.state), type=type(subject.state))
    assert msgspec.to_builtins(state) == msgspec.to_builtins(subject.state)
    subject.state, subject.device = state, subject.make()
    before = getattr(state, "sample_count", 0)
    subject.open()
    if subject.kind in ("torque", "emg"):
        assert subject.collect(1)[0].index[0] >= before
    else:
        assert state.homed


@every("stage")
def test_a_stage_sweeps_an_interval_at_the_times_it_says(subject: Subject) -> None:
    stage = subject.open()
    start_m = stage.sweep_start(-0.002, 0.002)
    subject.reach(stage.return_to(start_m, subject.now(), subject.state))
    if subject.name != "sim":
        subject.wait.until(lambda: not stage.feedback(subject.now(), subject.state).moving)
    times = stage.sweep(-0.002, 0.002, subject.now(), subject.state)
    assert times.enter_ns < times.leave_ns < times.end_ns
    subject.reach(times.end_ns)
    if subject.name != "sim":
        subject.wait.until(lambda: not stage.feedback(subject.now(), subject.state).moving)
    place = stage.read(np.array([times.enter_ns, times.leave_ns]), subject.state)
    np.testing.assert_allclose(place.y_m, [-0.002, 0.002], atol=1e-3)  # 1 s of a busy machine, emulated
    np.testing.assert_allclose(place.z_m, 0.0, atol=1e-4)


@every("stage")
def test_a_stage_sweeps_back_at_another_speed_and_height_where_it_is_asked_to(subject: Subject) -> None:
    stage = subject.open()
    how = {"speed_m_per_s": 0.010}
    start_m = stage.sweep_start(0.002, -0.002, **how)
    assert start_m > 0.002
    subject.reach(stage.return_to(start_m, subject.now(), subject.state, height_m=0.001))
    if subject.name != "sim":
        subject.wait.until(lambda: not stage.feedback(subject.now(), subject.state).moving)
    times = stage.sweep(0.002, -0.002, subject.now(), subject.state, **how, height_m=0.001)
    assert (times.leave_ns - times.enter_ns) * 1e-9 == pytest.approx(0.4, rel=0.01)
    subject.reach(times.end_ns)
    if subject.name != "sim":
        subject.wait.until(lambda: not stage.feedback(subject.now(), subject.state).moving)
    place = stage.read(np.array([times.enter_ns, times.leave_ns]), subject.state)
    np.testing.assert_allclose(place.y_m, [0.002, -0.002], atol=1e-3)
    np.testing.assert_allclose(place.z_m, 0.001, atol=1e-4)


@every("stage")
def test_a_stage_says_where_it_is_and_raises_the_probe(subject: Subject) -> None:
    stage = subject.open()
    subject.reach(stage.return_to(0.001, subject.now(), subject.state))
    subject.wait.until(lambda: not stage.feedback(subject.now(), subject.state).moving)
    low = stage.feedback(subject.now(), subject.state)
    np.testing.assert_allclose((low.y_m, low.z_m), (0.001, 0.0), atol=1e-4)
    subject.reach(stage.retreat(0.010, subject.now(), subject.state))
    subject.wait.until(lambda: not stage.feedback(subject.now(), subject.state).moving)
    high = stage.feedback(subject.now(), subject.state)
    assert high.z_m == pytest.approx(stage.lift_m, abs=1e-4)
    assert high.y_m == pytest.approx(0.001, abs=1e-4)


@every("stage", "ring")
def test_what_moves_takes_an_acknowledgement_and_is_well_after_it(subject: Subject) -> None:
    device = subject.open()
    device.acknowledge(subject.now(), subject.state)
    assert device.health(subject.now()).ok


@every("stage")
def test_a_stage_refuses_what_leaves_its_window(subject: Subject) -> None:
    stage = subject.open()
    for target_m in (0.2, -0.2, float("nan"), float("inf")):
        with pytest.raises(DeviceError, match="must lie in"):
            stage.return_to(target_m, subject.now(), subject.state)
    with pytest.raises(DeviceError, match="must lie in"):
        stage.sweep(-0.2, 0.2, subject.now(), subject.state)
    with pytest.raises(DeviceError, match="first"):
        stage.sweep(-0.002, 0.002, subject.now(), subject.state)  # raised, and in the middle


@every("stage")
def test_a_stage_takes_one_move_at_a_time_and_stops_when_told(subject: Subject) -> None:
    stage = subject.open()
    stage.return_to(-0.02, subject.now(), subject.state)
    with pytest.raises(DeviceError, match="moves"):
        stage.return_to(0.0, subject.now(), subject.state)
    rest_ns = stage.stop(subject.now(), subject.state)
    subject.reach(rest_ns)
    if subject.name != "sim":
        subject.wait.until(
            lambda: not stage.feedback(subject.now(), subject.state).moving and stage.health(subject.now()).ok
        )
    assert stage.return_to(0.0, subject.now(), subject.state) >= subject.now()


@every("stage", "ring")
def test_what_moves_refuses_before_it_was_opened(subject: Subject) -> None:
    device, now_ns, state = subject.device, subject.now(), subject.state
    stage_or_ring = {
        "stage": lambda: device.return_to(0.0, now_ns, state),
        "ring": lambda: device.command(0.001, now_ns, state, subject.rng),
    }
    with pytest.raises(DeviceError, match="open it"):
        stage_or_ring[subject.kind]()


@every("ring")
def test_a_ring_arrives_and_says_so(subject: Subject) -> None:
    ring = subject.open()
    settled_ns = ring.command(0.001, subject.now(), subject.state, subject.rng)
    assert not ring.read(subject.now(), subject.state).settled
    subject.reach(settled_ns)
    subject.wait.until(lambda: ring.read(subject.now(), subject.state).settled)
    reading = ring.read(subject.now(), subject.state)
    assert reading.target_m == 0.001
    assert reading.measured_m == pytest.approx(0.001, abs=0.4e-3)


@every("ring")
def test_a_ring_refuses_targets_beyond_its_stroke(subject: Subject) -> None:
    ring = subject.open()
    for target_m in (-0.001, 0.0501, float("nan")):
        with pytest.raises(DeviceError, match="target_m"):
            ring.command(target_m, subject.now(), subject.state, subject.rng)


@every("ring")
def test_a_ring_holds_where_it_was_stopped(subject: Subject) -> None:
    ring = subject.open()
    ring.command(0.010, subject.now(), subject.state, subject.rng)
    subject.reach(subject.now() + 100_000_000)
    ring.stop(subject.now(), subject.state)
    reading = ring.read(subject.now(), subject.state)
    assert not reading.settled
    assert reading.measured_m < 0.009


@every("torque")
def test_torque_samples_are_numbered_and_in_order(subject: Subject) -> None:
    subject.open()
    blocks = subject.collect(150)
    times_ns = np.concatenate([block.times_ns for block in blocks])
    index = np.concatenate([block.index for block in blocks])
    gap = np.concatenate([block.gap for block in blocks])
    assert np.all(np.diff(times_ns) > 0)
    assert np.all((np.diff(index) == 1) | gap[1:])
    assert np.all(np.diff(index) >= 1)
    assert not any(block.faulty.any() for block in blocks)
    assert all(np.all(np.isfinite(block.torque_n_m)) for block in blocks)


@every("torque")
def test_taring_makes_the_present_load_the_zero(subject: Subject) -> None:
    sensor = subject.open()
    blocks = subject.collect(50)
    parts = {
        name: np.concatenate([getattr(block, name) for block in blocks])
        for name in ("times_ns", "torque_n_m", "wrench", "faulty")
    }
    sensor.tare(replace(blocks[-1], **parts), subject.state)
    sensor.drain(subject.now(), subject.state, subject.rng)
    torque_n_m = np.concatenate([block.torque_n_m for block in subject.collect(100)])
    assert abs(torque_n_m.mean()) < 20e-6


@every("emg")
def test_emg_samples_are_numbered_and_evenly_spaced(subject: Subject) -> None:
    source = subject.open()
    blocks = subject.collect(max(300, round(source.rate_hz)))
    index = np.concatenate([block.index for block in blocks])
    times_ns = np.concatenate([block.times_ns for block in blocks])
    gap = np.concatenate([block.gap for block in blocks])
    assert np.all(np.diff(times_ns) > 0)
    assert np.all((np.diff(index) == 1) | gap[1:])
    # within a block the clock's fit is one; after a second a burst that came late bends it no more
    long = max(blocks[len(blocks) // 2 :], key=lambda block: len(block.times_ns))
    spacing_s = (long.times_ns[-1] - long.times_ns[0]) * 1e-9 / (long.index[-1] - long.index[0])
    assert spacing_s == pytest.approx(1.0 / source.rate_hz, rel=0.25)
    assert all(block.fds_v.shape == block.edc_v.shape == block.times_ns.shape for block in blocks)
