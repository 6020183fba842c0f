"""What the rig asks of a stage, a ring actuator, a torque sensor and an EMG amplifier.

Every device, simulated or real, keeps what it must remember in a small state that the **caller** holds,
passes to each call and can serialise at any time: whoever takes over opens a device of its own with that
state and continues. ``open`` on a fresh state brings the device up (homes, draws); on a state that was up
already it only connects. ``close`` only releases the link and leaves the state alone. Time comes in as
integer nanoseconds and randomness as a generator; real devices ignore what they do not need. Commands change
the state in place.

A state type belongs to its back end: a protocol names it by its type variable, and a driver that remembers
nothing on the host takes ``object``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.devices.health import DeviceHealth
from palp_core.units import Float64Array

Int64Array = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
S = TypeVar("S", contravariant=True)


@dataclass(frozen=True)
class ClockFit:
    """A device's clock on the host's: host time = ``offset_ns`` + (1 + ``drift``) device time.

    Attributes:
        offset_ns: Host time of the device's time 0.
        drift: Host seconds per device second, minus 1.
        residual_s: Root mean square of what the line leaves over.
        span_s: Device time that the estimate rests on; 0 where host times are exact (a simulation, a poll).
    """

    offset_ns: int
    drift: float
    residual_s: float
    span_s: float


EXACT = ClockFit(0, 0.0, 0.0, 0.0)
"""The clock of a device that is stamped by the host itself."""


def _no_index() -> Int64Array:
    return np.empty(0, dtype=np.int64)


def _no_gap() -> BoolArray:
    return np.empty(0, dtype=np.bool_)


def _no_wrench() -> Float64Array:
    return np.empty((0, 6))


class SweepTimes(msgspec.Struct, frozen=True):
    """When a sweep is at constant speed over the interval it was asked for, and when it ends.

    A sample is over the interval if ``enter_ns <= stamp_ns <= leave_ns``. A driver predicts these times.
    """

    enter_ns: int
    leave_ns: int
    end_ns: int


@dataclass(frozen=True, eq=False)
class StageReading:
    """Positions of the stage, arrays of shape (n,): along the sweep and above the scanning height."""

    y_m: Float64Array
    z_m: Float64Array


@dataclass(frozen=True)
class RingReading:
    """What the ring actuator tells about itself; its true position is not among it."""

    target_m: float
    measured_m: float
    settled: bool


@dataclass(frozen=True, eq=False)
class TorqueSamples:
    """Torque about x, arrays of shape (n,); a saturated sample is clipped to the range and counted.

    Attributes:
        times_ns: Host times.
        torque_n_m: Torque about the sensor's axis that the joint turns about.
        saturated_count: Samples at the end of the range.
        index: Number of each sample since the first open, lost ones counted.
        gap: Whether samples are missing just before this one.
        faulty: Whether a sample must not be used: saturated, or the device says so.
        wrench: Forces in N and torques in N m about x, y, z, shape (n, 6); (0, 6) for a one-axis source.
        clock: The device's clock.
    """

    times_ns: Int64Array
    torque_n_m: Float64Array
    saturated_count: int
    index: Int64Array = field(default_factory=_no_index)
    gap: BoolArray = field(default_factory=_no_gap)
    faulty: BoolArray = field(default_factory=_no_gap)
    wrench: Float64Array = field(default_factory=_no_wrench)
    clock: ClockFit = EXACT


@dataclass(frozen=True, eq=False)
class EmgSamples:
    """Raw EMG of the finger flexor (FDS) and extensor (EDC), arrays of shape (n,).

    ``index``, ``gap`` and ``clock`` are as in :class:`TorqueSamples`.
    """

    times_ns: Int64Array
    fds_v: Float64Array
    edc_v: Float64Array
    index: Int64Array = field(default_factory=_no_index)
    gap: BoolArray = field(default_factory=_no_gap)
    clock: ClockFit = EXACT


class StageDevice(Protocol[S]):
    """Sweep one way over the tissue at constant speed, and come back by another path."""

    def open(self, now_ns: int, state: S, rng: np.random.Generator) -> None: ...
    def close(self) -> None: ...
    def health(self, now_ns: int) -> DeviceHealth: ...

    def sweep_start(self, from_m: float, to_m: float) -> float:
        """Return the y from which a sweep over [from_m, to_m] has the room to reach its speed, in m."""

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: S) -> SweepTimes:
        """Sweep from here, at constant speed all the way from ``from_m`` to ``to_m``."""

    def return_to(self, y_m: float, now_ns: int, state: S) -> int:
        """Raise, go to ``y_m``, lower; return the time of arrival in ns."""

    def stop(self, now_ns: int, state: S) -> int:
        """Decelerate to rest where it is, whatever it was doing; return the time of rest in ns."""

    def read(self, times_ns: Int64Array, state: S) -> StageReading: ...


class RingDevice(Protocol[S]):
    """Move the anchor ring, and with it the stiffness of the joint."""

    def open(self, now_ns: int, state: S, rng: np.random.Generator) -> None: ...
    def close(self) -> None: ...
    def health(self, now_ns: int) -> DeviceHealth: ...

    def command(self, target_m: float, now_ns: int, state: S, rng: np.random.Generator) -> int:
        """Go to ``target_m``; return the time at which it will have settled, in ns."""

    def rehome(self, now_ns: int, state: S, rng: np.random.Generator) -> int:
        """Drive to the retracted stop and back to the target; return the time of settling in ns."""

    def stop(self, now_ns: int, state: S) -> None:
        """Hold where it is, at once."""

    def read(self, now_ns: int, state: S) -> RingReading: ...


class TorqueSensor(Protocol[S]):
    """Measure the torque between connecting and base link."""

    def open(self, now_ns: int, state: S, rng: np.random.Generator) -> None: ...
    def close(self) -> None: ...
    def health(self, now_ns: int) -> DeviceHealth: ...

    def drain(self, now_ns: int, state: S, rng: np.random.Generator) -> TorqueSamples:
        """Return every sample received since the last call; a simulated sensor is unloaded here."""

    def tare(self, block: TorqueSamples, state: S) -> None:
        """Make the mean of ``block``, read unloaded, the new zero."""


class EmgDevice(Protocol[S]):
    """Deliver the raw EMG of two muscles."""

    @property
    def rate_hz(self) -> float: ...

    def open(self, now_ns: int, state: S, rng: np.random.Generator) -> None: ...
    def close(self) -> None: ...
    def health(self, now_ns: int) -> DeviceHealth: ...

    def drain(self, now_ns: int, state: S, rng: np.random.Generator) -> EmgSamples:
        """Return every sample since the last call up to and including ``now_ns``."""
