"""What a device of each kind promises, as pytest classes: for palp's drivers, for yours, and for hardware.

A class of the device's kind has the promises as tests; a fixture ``subject`` gives the device::

    class TestMyRing(RingContract):
        @pytest.fixture
        def subject(self):
            with Subject("ring", "drivers.my_ring:MyRing", simulated=True) as subject:
                yield subject

``palp devices contract`` runs them without pytest.
"""

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Self

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.graph.clock import monotonic_ns
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.registry import open_device


@dataclass
class Subject:
    """A device whose promises are checked, with its state and its time.

    Attributes:
        kind: ``stage``, ``ring``, ``torque`` or ``emg``.
        name: Of the device, or ``module:Class``.
        options: Of its driver.
        simulated: Its time is the one it is given, not the machine's.
        patience_s: Longest wait for what it does in its own time.

    Raises:
        DeviceError: The driver cannot be made: another name, an option, or a member that its kind wants.
    """

    kind: str
    name: str
    options: dict[str, Any] = field(default_factory=dict)
    simulated: bool = False
    patience_s: float = 60.0

    def __post_init__(self) -> None:
        self.rng, self.sim_ns = np.random.default_rng(0), 0
        self.device = self.make()
        self.state: Any = self.device.state_type()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.device.close()

    def make(self) -> Any:
        return open_device(self.kind, self.name, **self.options)  # type: ignore[call-overload]

    def now(self) -> int:
        return self.sim_ns if self.simulated else monotonic_ns()

    def call(self, method: str, *given: Any, **how: Any) -> Any:
        """Call a method of the device that takes the time and the state."""
        draws = (self.rng,) if method in ("open", "command", "drain") else ()
        return getattr(self.device, method)(*given, self.now(), self.state, *draws, **how)

    def move(self, method: str, *given: Any, **how: Any) -> Any:
        """Let a stage move, and wait until it rests; return what it predicted."""
        predicted = self.call(method, *given, **how)
        self.reach(getattr(predicted, "end_ns", predicted))
        self.until(lambda: not self.call("feedback").moving, "the stage to stand still")
        return predicted

    def reach(self, at_ns: int) -> None:
        """Let the time come."""
        self.sim_ns = max(self.sim_ns, at_ns)
        self.until(lambda: self.now() >= at_ns, "the time to come")

    def until(self, holds: Callable[[], object], what: str) -> None:
        """Wait for what the device does, never for a length of time."""
        pause, end_ns = threading.Event(), monotonic_ns() + round(self.patience_s * 1e9)
        while not holds():
            assert monotonic_ns() < end_ns, f"waited {self.patience_s:g} s in vain for {what}"
            pause.wait(0.002)

    def collect(self, count: int) -> dict[str, Any]:
        """Drain until there are so many samples; return them as arrays by field, and ``blocks``."""
        blocks: list[Any] = []

        def enough() -> bool:
            self.sim_ns += 10_000_000
            blocks.append(self.call("drain"))
            return sum(len(block.times_ns) for block in blocks) >= count

        self.until(enough, "its samples")
        blocks = [block for block in blocks if len(block.times_ns)]
        arrays = [name for name, value in vars(blocks[0]).items() if isinstance(value, np.ndarray)]
        return {
            "blocks": blocks,
            **{name: np.concatenate([getattr(block, name) for block in blocks]) for name in arrays},
        }


@contextmanager
def _refused(words: str, what: str) -> Iterator[None]:
    """Expect that a device refuses something, with a message in which there are these words."""
    refusal = ""
    try:
        yield
    except DeviceError as error:
        refusal = str(error)
    assert refusal, f"it does not refuse {what} (with a DeviceError that contains '{words}')"
    assert re.search(words, refusal), f"it refuses {what}, but does not say '{words}': {refusal}"


def _near(value: Any, wanted: Any, within: float, what: str) -> None:
    values, targets = np.asarray(value, float), np.asarray(wanted, float)
    near = values.shape == targets.shape and np.all(np.abs(values - targets) <= within)
    assert near, f"{what}: {value}, which is not within {within:g} of {wanted}"


class DeviceContract:
    """What every device promises."""

    def test_an_open_device_is_well_and_closing_it_twice_is_harmless(self, subject: Subject) -> None:
        """The health of an open device is OK. Closed, it is CLOSED, except for a simulated device."""
        subject.call("open")
        health = subject.device.health(subject.now())
        assert health.ok, f"open, it is not well: {health}"
        subject.device.close()
        subject.device.close()
        after = subject.device.health(subject.now()).condition
        assert subject.simulated or after is Condition.CLOSED, f"closed, its health says {after}, not closed"

    def test_a_successor_goes_on_with_the_state(self, subject: Subject) -> None:
        """The state holds all that the next process needs, and can be written to a file."""
        samples = subject.kind in ("torque", "emg")
        subject.call("open")
        if samples:
            subject.collect(20)
        subject.device.close()
        before, written = subject.state, msgspec.msgpack.encode(subject.state)
        subject.state = msgspec.msgpack.decode(written, type=type(before))
        same = msgspec.to_builtins(subject.state) == msgspec.to_builtins(before)
        assert same, "its state is another once it was written down and read"
        subject.device = subject.make()
        subject.call("open")
        if samples:
            first = subject.collect(1)["index"][0]
            assert first >= before.sample_count, f"its samples begin again at {first}: go on from the state"
        else:
            assert subject.state.homed, "its state does not say that it is homed after it was opened"


class MoverContract(DeviceContract):
    """What a stage or a ring promises."""

    def test_what_moves_takes_an_acknowledgement_and_is_well_after_it(self, subject: Subject) -> None:
        """The device is well before the acknowledgement and after it."""
        subject.call("open")
        subject.call("acknowledge")
        health = subject.device.health(subject.now())
        assert health.ok, f"acknowledged, it is not well: {health}"

    def test_what_moves_refuses_before_it_was_opened(self, subject: Subject) -> None:
        """The device raises an error that asks to open it first."""
        method = {"stage": "return_to", "ring": "command"}[subject.kind]
        with _refused("open it", "to move before it was opened"):
            subject.call(method, 0.001)


class SensorContract(DeviceContract):
    """What a torque sensor or an EMG amplifier promises."""

    def test_samples_are_numbered_and_in_order(self, subject: Subject) -> None:
        """Times and numbers rise. A number is missing only at a gap. No sample is NaN or faulty."""
        subject.call("open")
        found = subject.collect(150)
        step = np.diff(found["index"])
        assert np.all(np.diff(found["times_ns"]) > 0), "its samples' times do not grow"
        assert np.all(step >= 1), "its samples' numbers do not grow"
        assert np.all((step == 1) | found["gap"][1:]), "a number is missing where there is no gap"
        assert not np.any(found.get("faulty", False)), "samples of a device that is well are faulty"
        names = {"torque": ("torque_n_m",), "emg": ("fds_v", "edc_v")}[subject.kind]
        lacking = ", no ".join(name for name in names if name not in found)
        assert not lacking, f"its samples have no {lacking}; a torque sensor must have the method tare"
        for name in names:
            assert found[name].shape == found["times_ns"].shape, f"{name} has not a value for each time"
            assert np.all(np.isfinite(found[name])), f"{name} is NaN or infinite"


class StageContract(MoverContract):
    """What a stage promises."""

    def test_a_stage_sweeps_an_interval_both_ways_at_the_times_it_says(self, subject: Subject) -> None:
        """The position is within 1 mm along y, to allow for a busy host, and within 0.1 mm in height."""
        subject.call("open")
        for from_m, to_m in ((-0.002, 0.002), (0.002, -0.002)):
            start_m = subject.device.sweep_start(from_m, to_m)
            before = (from_m - start_m) * (to_m - from_m) > 0.0
            assert before, f"a sweep from {from_m} m begins at {start_m} m, not before the interval"
            subject.move("return_to", start_m)
            times = subject.move("sweep", from_m, to_m)
            assert times.enter_ns < times.leave_ns < times.end_ns, f"its times are not in order: {times}"
            place = subject.device.read(np.array([times.enter_ns, times.leave_ns]), subject.state)
            _near(place.y_m, [from_m, to_m], 1e-3, "y at the times it predicted, m")
            _near(place.z_m, [0.0, 0.0], 1e-4, "z in the sweep, m")

    def test_a_stage_says_where_it_is_and_raises_the_probe(self, subject: Subject) -> None:
        """The feedback gives the position and height of the command. A retreat changes the height only."""
        subject.call("open")
        lift_m = subject.device.lift_m
        for y_m, z_m, given, how in (
            (-0.001, lift_m, ("return_to", -0.001), {"height_m": lift_m}),
            (0.001, 0.0, ("return_to", 0.001), {}),
            (0.001, lift_m, ("retreat", 0.010), {}),
        ):
            subject.move(*given, **how)
            here = subject.call("feedback")
            _near((here.y_m, here.z_m), (y_m, z_m), 1e-4, "where it is, m")
            measured = 0 < here.asked_ns <= here.answered_ns <= subject.now()
            assert measured, f"it was measured from {here.asked_ns} to {here.answered_ns} ns, not before now"

    def test_a_stage_goes_across_only_while_it_is_raised(self, subject: Subject) -> None:
        """The height is measured. A place outside the limits is refused; so is any without a third axis."""
        subject.call("open")
        low_m, high_m = subject.device.limits.x_m
        for target_m in (low_m - 0.001, high_m + 0.001, float("nan")):
            with _refused("across_m", f"a place across of {target_m} m"):
                subject.call("return_to", 0.0, across_m=target_m)
        if not subject.device.moves_across or low_m == high_m:
            return
        to_m, seen = min(high_m, 0.002), []
        subject.move("return_to", 0.0)
        subject.call("return_to", 0.001, across_m=to_m)

        def rests() -> bool:
            subject.sim_ns += 10_000_000
            seen.append(subject.call("feedback"))
            return not seen[-1].moving

        subject.until(rests, "the stage to stand still")
        heights_m = [here.z_m for here in seen if 1e-4 < here.x_m < to_m - 1e-4]
        assert heights_m, f"it was never seen on its way across: {seen[-1]}"
        _near(heights_m, np.full(len(heights_m), subject.device.lift_m), 2e-4, "height on the way across, m")
        _near((seen[-1].y_m, seen[-1].z_m, seen[-1].x_m), (0.001, 0.0, to_m), 1e-4, "where it is, m")

    def test_a_stage_refuses_what_leaves_its_window(self, subject: Subject) -> None:
        """The stage also refuses a sweep from a position where no sweep begins."""
        subject.call("open")
        for target_m in (0.2, -0.2, float("nan"), float("inf")):
            with _refused("must lie in", f"a return to {target_m} m"):
                subject.call("return_to", target_m)
        with _refused("must lie in", "a sweep from -0.2 to 0.2 m"):
            subject.call("sweep", -0.2, 0.2)
        with _refused("first", "a sweep while it is raised and in the middle"):
            subject.call("sweep", -0.002, 0.002)

    def test_a_stage_takes_one_move_at_a_time_and_stops_when_it_must(self, subject: Subject) -> None:
        """After a stop, the stage accepts the next move."""
        subject.call("open")
        subject.call("return_to", -0.02)
        with _refused("moves", "a second move while it moves"):
            subject.call("return_to", 0.0)
        subject.move("stop")
        subject.until(lambda: subject.device.health(subject.now()).ok, "it to be well after a stop")
        assert subject.call("return_to", 0.0) >= subject.now(), "its move ends before it began"


class RingContract(MoverContract):
    """What a ring promises."""

    def test_a_ring_arrives_and_says_so(self, subject: Subject) -> None:
        """The measured position is within 0.4 mm of the target."""
        subject.call("open")
        settled_ns = subject.call("command", 0.001)
        assert not subject.call("read").settled, "it is settled before it has moved"
        subject.reach(settled_ns)
        subject.until(lambda: subject.call("read").settled, "it to settle")
        reading = subject.call("read")
        assert reading.target_m == 0.001, (
            f"its target is {reading.target_m} m, not the 0.001 m it was sent to"
        )
        _near(reading.measured_m, 0.001, 0.4e-3, "where it is, m")

    def test_a_ring_refuses_targets_beyond_its_stroke(self, subject: Subject) -> None:
        """The error names the argument `target_m`."""
        subject.call("open")
        for target_m in (-0.001, 0.0501, float("nan")):
            with _refused("target_m", f"a target of {target_m} m"):
                subject.call("command", target_m)

    def test_a_ring_holds_where_it_was_stopped(self, subject: Subject) -> None:
        """A ring that is stopped 0.1 s into a move of 10 mm stays there."""
        subject.call("open")
        subject.call("command", 0.010)
        subject.reach(subject.now() + 100_000_000)
        subject.call("stop")
        reading = subject.call("read")
        assert not reading.settled, "stopped on its way, it says that it has settled"
        assert reading.measured_m < 0.009, f"stopped after 0.1 s it is at {reading.measured_m} m of 0.010"


class TorqueContract(SensorContract):
    """What a torque sensor promises."""

    def test_taring_makes_the_present_load_the_zero(self, subject: Subject) -> None:
        """The mean of the next 100 samples is within 20 uN m of zero. The load must not change meanwhile."""
        subject.call("open")
        found = subject.collect(50)
        last = found.pop("blocks")[-1]
        subject.device.tare(replace(last, **found), subject.state)
        subject.call("drain")
        mean_n_m = subject.collect(100)["torque_n_m"].mean()
        # means of 50 and 100 samples, noisy by one step of the sensor, differ by 3 uN m; the rest is drift
        _near(mean_n_m, 0.0, 20e-6, "mean torque after taring, N m; was the load still meanwhile?")


class EmgContract(SensorContract):
    """What an EMG amplifier promises."""

    def test_emg_samples_are_evenly_spaced(self, subject: Subject) -> None:
        """The mean spacing within a block fits the stated rate within 25 %."""
        subject.call("open")
        blocks = subject.collect(max(300, round(subject.device.rate_hz)))["blocks"]
        # within a block the clock's fit is one; after a second a burst that came late bends it no more
        long = max(blocks[len(blocks) // 2 :], key=lambda block: len(block.times_ns))
        spacing_s = (long.times_ns[-1] - long.times_ns[0]) * 1e-9 / (long.index[-1] - long.index[0])
        _near(spacing_s * subject.device.rate_hz, 1.0, 0.25, "spacing of samples times the rate")


CONTRACTS: dict[str, type[DeviceContract]] = {
    "stage": StageContract,
    "ring": RingContract,
    "torque": TorqueContract,
    "emg": EmgContract,
}
"""The promises of each kind of device."""


def promises_of(kind: str) -> dict[str, Callable[[Subject], None]]:
    """Return the promises of a kind of device, by their words."""
    contract = CONTRACTS[kind]
    names = [name for one in reversed(contract.__mro__) for name in vars(one) if name.startswith("test_")]
    return {
        name.removeprefix("test_").replace("_", " "): getattr(contract(), name)
        for name in dict.fromkeys(names)
    }
