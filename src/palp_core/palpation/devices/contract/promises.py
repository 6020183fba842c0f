"""The promises, each a function that a subject of its kinds goes through; the first broken one ends it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from palp_core.palpation.devices.contract.subject import Subject, must, refused
from palp_core.palpation.devices.health import Condition

Check = Callable[[Subject], None]


@dataclass(frozen=True)
class Promise:
    """One promise: whose it is, and what checks it; its name says it in words."""

    kinds: tuple[str, ...]
    check: Check

    @property
    def text(self) -> str:
        """What is promised, in words."""
        return self.check.__name__.replace("_", " ")


PROMISES: list[Promise] = []
"""All of them, in the order in which they are checked."""


def promise(*kinds: str) -> Callable[[Check], Check]:
    """Add a check of devices of these kinds."""

    def add(check: Check) -> Check:
        PROMISES.append(Promise(kinds, check))
        return check

    return add


def _near(value: Any, wanted: Any, within: float, what: str, hint: str = "") -> None:
    values, targets = np.asarray(value, float), np.asarray(wanted, float)
    must(
        values.shape == targets.shape and np.all(np.abs(values - targets) <= within),
        f"{what}: {value}, which is not within {within:g} of {wanted}{hint}",
    )


@promise("stage", "ring", "torque", "emg")
def an_open_device_is_well_and_closing_it_twice_is_harmless(subject: Subject) -> None:
    """Its health is OK when it is open, and CLOSED when it is closed, but for a simulated one."""
    device = subject.open()
    must(device.health(subject.now()).ok, f"open, it is not well: {device.health(subject.now())}")
    device.close()
    device.close()
    if not subject.simulated:
        after = device.health(subject.now()).condition
        must(after is Condition.CLOSED, f"closed, its health says {after}, not {Condition.CLOSED}")


@promise("stage", "ring", "torque", "emg")
def a_successor_goes_on_with_the_state(subject: Subject) -> None:
    """All that the next process needs is in the state, and can be written down."""
    subject.open()
    if subject.kind in ("torque", "emg"):
        subject.collect(20)
    subject.device.close()
    state = msgspec.msgpack.decode(msgspec.msgpack.encode(subject.state), type=type(subject.state))
    must(
        msgspec.to_builtins(state) == msgspec.to_builtins(subject.state),
        "its state is another once it was written down and read",
    )
    subject.state, subject.device = state, subject.make()
    before = getattr(state, "sample_count", 0)
    subject.open()
    if subject.kind in ("torque", "emg"):
        first = subject.collect(1)[0].index[0]
        must(first >= before, f"its samples begin anew at {first}, after {before}: go on from the state")
    else:
        must(state.homed, "its state does not say that it is homed after it was opened")


@promise("stage")
def a_stage_sweeps_an_interval_both_ways_at_the_times_it_says(subject: Subject) -> None:
    """Within 1 mm along y, which is what a busy machine takes, and 0.1 mm in height."""
    stage = subject.open()
    for from_m, to_m in ((-0.002, 0.002), (0.002, -0.002)):
        start_m = stage.sweep_start(from_m, to_m)
        must(
            (from_m - start_m) * (to_m - from_m) > 0.0,
            f"a sweep from {from_m} to {to_m} m begins at {start_m} m, not before the interval",
        )
        subject.reach(stage.return_to(start_m, subject.now(), subject.state))
        subject.rest()
        times = stage.sweep(from_m, to_m, subject.now(), subject.state)
        must(times.enter_ns < times.leave_ns < times.end_ns, f"its times are not in order: {times}")
        subject.reach(times.end_ns)
        subject.rest()
        place = stage.read(np.array([times.enter_ns, times.leave_ns]), subject.state)
        _near(place.y_m, [from_m, to_m], 1e-3, "y at the times it said, m")
        _near(place.z_m, [0.0, 0.0], 1e-4, "z in the sweep, m")


@promise("stage")
def a_stage_says_where_it_is_and_raises_the_probe(subject: Subject) -> None:
    """Its feedback is where it was sent, at the height it was sent to; a retreat leaves y as it is."""
    stage = subject.open()
    subject.reach(stage.return_to(-0.001, subject.now(), subject.state, height_m=stage.lift_m))
    subject.rest()
    above = stage.feedback(subject.now(), subject.state)
    _near((above.y_m, above.z_m), (-0.001, stage.lift_m), 1e-4, "where it is, raised, m")
    subject.reach(stage.return_to(0.001, subject.now(), subject.state))
    subject.rest()
    low = stage.feedback(subject.now(), subject.state)
    _near((low.y_m, low.z_m), (0.001, 0.0), 1e-4, "where it is, m")
    between = f"between {low.asked_ns} and {low.answered_ns} ns, which is not before now"
    must(0 < low.asked_ns <= low.answered_ns <= subject.now(), f"it says that it was measured {between}")
    subject.reach(stage.retreat(0.010, subject.now(), subject.state))
    subject.rest()
    high = stage.feedback(subject.now(), subject.state)
    _near((high.y_m, high.z_m), (0.001, stage.lift_m), 1e-4, "where it is once raised, m")


@promise("stage", "ring")
def what_moves_takes_an_acknowledgement_and_is_well_after_it(subject: Subject) -> None:
    """Nothing was wrong, and nothing is."""
    device = subject.open()
    device.acknowledge(subject.now(), subject.state)
    must(device.health(subject.now()).ok, f"acknowledged, it is not well: {device.health(subject.now())}")


@promise("stage")
def a_stage_refuses_what_leaves_its_window(subject: Subject) -> None:
    """And a sweep from where no sweep begins."""
    stage = subject.open()
    for target_m in (0.2, -0.2, float("nan"), float("inf")):
        with refused("must lie in", f"a return to {target_m} m"):
            stage.return_to(target_m, subject.now(), subject.state)
    with refused("must lie in", "a sweep from -0.2 to 0.2 m"):
        stage.sweep(-0.2, 0.2, subject.now(), subject.state)
    with refused("first", "a sweep while it is raised and in the middle"):
        stage.sweep(-0.002, 0.002, subject.now(), subject.state)


@promise("stage")
def a_stage_takes_one_move_at_a_time_and_stops_when_told(subject: Subject) -> None:
    """After a stop it moves again."""
    stage = subject.open()
    stage.return_to(-0.02, subject.now(), subject.state)
    with refused("moves", "a second move while it moves"):
        stage.return_to(0.0, subject.now(), subject.state)
    subject.reach(stage.stop(subject.now(), subject.state))
    subject.rest()
    if not subject.simulated:
        subject.patience.until(lambda: stage.health(subject.now()).ok, "for it to be well after a stop")
    must(stage.return_to(0.0, subject.now(), subject.state) >= subject.now(), "its move ends before it began")


@promise("stage", "ring")
def what_moves_refuses_before_it_was_opened(subject: Subject) -> None:
    """Nothing moves without a link."""
    device, now_ns, state = subject.device, subject.now(), subject.state
    move = {
        "stage": lambda: device.return_to(0.0, now_ns, state),
        "ring": lambda: device.command(0.001, now_ns, state, subject.rng),
    }
    with refused("open it", "to move before it was opened"):
        move[subject.kind]()


@promise("ring")
def a_ring_arrives_and_says_so(subject: Subject) -> None:
    """Within 0.4 mm."""
    ring = subject.open()
    settled_ns = ring.command(0.001, subject.now(), subject.state, subject.rng)
    must(not ring.read(subject.now(), subject.state).settled, "it is settled before it has moved")
    subject.reach(settled_ns)
    subject.patience.until(lambda: ring.read(subject.now(), subject.state).settled, "for it to settle")
    reading = ring.read(subject.now(), subject.state)
    must(reading.target_m == 0.001, f"its target is {reading.target_m} m, not the 0.001 m it was sent to")
    _near(reading.measured_m, 0.001, 0.4e-3, "where it is, m")


@promise("ring")
def a_ring_refuses_targets_beyond_its_stroke(subject: Subject) -> None:
    """By the name of what is wrong."""
    ring = subject.open()
    for target_m in (-0.001, 0.0501, float("nan")):
        with refused("target_m", f"a target of {target_m} m"):
            ring.command(target_m, subject.now(), subject.state, subject.rng)


@promise("ring")
def a_ring_holds_where_it_was_stopped(subject: Subject) -> None:
    """A tenth of a second into 10 mm."""
    ring = subject.open()
    ring.command(0.010, subject.now(), subject.state, subject.rng)
    subject.reach(subject.now() + 100_000_000)
    ring.stop(subject.now(), subject.state)
    reading = ring.read(subject.now(), subject.state)
    must(not reading.settled, "stopped on its way, it says that it has settled")
    must(reading.measured_m < 0.009, f"stopped after 0.1 s it is at {reading.measured_m} m of 0.010")


@promise("torque")
def torque_samples_are_numbered_and_in_order(subject: Subject) -> None:
    """Their times and numbers rise; a number is missing only where a gap is said. None is NaN or faulty."""
    subject.open()
    blocks = subject.collect(150)
    _in_order(blocks)
    must(not any(block.faulty.any() for block in blocks), "samples of a device that is well are faulty")
    must(all(np.all(np.isfinite(block.torque_n_m)) for block in blocks), "a torque is NaN or infinite")


def _in_order(blocks: list[Any]) -> None:
    times_ns = np.concatenate([block.times_ns for block in blocks])
    index = np.concatenate([block.index for block in blocks])
    gap = np.concatenate([block.gap for block in blocks])
    must(np.all(np.diff(times_ns) > 0), "its samples' times do not grow")
    must(np.all(np.diff(index) >= 1), "its samples' numbers do not grow")
    must(np.all((np.diff(index) == 1) | gap[1:]), "a number is missing where no gap is said")


@promise("torque")
def taring_makes_the_present_load_the_zero(subject: Subject) -> None:
    """Within 20 uN m, the mean of 100 samples; what presses on the sensor must be still meanwhile."""
    sensor = subject.open()
    blocks = subject.collect(50)
    parts = {
        name: np.concatenate([getattr(block, name) for block in blocks])
        for name in ("times_ns", "torque_n_m", "wrench", "faulty")
    }
    sensor.tare(replace(blocks[-1], **parts), subject.state)
    sensor.drain(subject.now(), subject.state, subject.rng)
    torque_n_m = np.concatenate([block.torque_n_m for block in subject.collect(100)])
    still = "; was the sensor's load still meanwhile, from 50 samples before taring to 100 after?"
    # means of 50 and of 100 samples, noisy by a step of the rig's sensor, differ by 3 uN m; the rest is drift
    _near(torque_n_m.mean(), 0.0, 20e-6, "mean torque after taring, N m", still)


@promise("emg")
def emg_samples_are_numbered_and_evenly_spaced(subject: Subject) -> None:
    """In order as those of torque, at the rate it states, within a quarter over a block."""
    source = subject.open()
    blocks = subject.collect(max(300, round(source.rate_hz)))
    _in_order(blocks)
    # within a block the clock's fit is one; after a second a burst that came late bends it no more
    long = max(blocks[len(blocks) // 2 :], key=lambda block: len(block.times_ns))
    spacing_s = (long.times_ns[-1] - long.times_ns[0]) * 1e-9 / (long.index[-1] - long.index[0])
    _near(spacing_s * source.rate_hz, 1.0, 0.25, "spacing of samples times the rate")
    shapes = {(block.fds_v.shape, block.edc_v.shape) for block in blocks if block.times_ns.shape}
    must(
        all(block.fds_v.shape == block.edc_v.shape == block.times_ns.shape for block in blocks),
        f"its muscles have other numbers of samples than its times: {shapes}",
    )
