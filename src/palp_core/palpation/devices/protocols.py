"""What the rig asks of a stage, a ring actuator, a torque sensor and an EMG amplifier.

Every device, simulated or real, keeps what it must remember in a small state that the **caller** holds,
passes to each call and can serialise at any time: a successor opens a device of its own with that
state and continues. ``open`` on a fresh state brings the device up (homes, draws); on a state that was up
already it only connects. ``close`` only releases the link and leaves the state alone. Time comes in as
integer nanoseconds and randomness as a generator; real devices ignore what they do not need. Commands change
the state in place.

A state type belongs to its back end, which names it as ``state_type``; a protocol names it by its type
variable. A state that was serialised comes back by :func:`restored`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple, Protocol, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from palp_core.errors import DeviceError, in_words
from palp_core.palpation.devices.health import DeviceHealth
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.units import Float64Array

Int64Array = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Direction = Literal["y", "z", "x"]
"""Ways of a stage: along the sweep, up, across the sweep."""
S = TypeVar("S")


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
    """The times between which a sweep has constant speed over its interval, and its end.

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
    """What the ring actuator reports; its true position is not included.

    ``waits``: for what it waits before it moves, as a text; "" while it moves or rests.
    """

    target_m: float
    measured_m: float
    settled: bool
    waits: str = ""


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


class StageFeedback(NamedTuple):
    """Where the stage was measured last, the largest of its speeds, and whether a path is under way.

    All places were measured between ``asked_ns`` and ``answered_ns``; ``x_m`` is across the sweep.
    """

    y_m: float
    z_m: float
    speed_m_per_s: float
    moving: bool
    asked_ns: int
    answered_ns: int
    x_m: float = 0.0


@dataclass(frozen=True)
class StopTimes:
    """Monotonic times of a stop: written, all axes at rest as far as is known, all disabled."""

    written_ns: int
    resting_ns: int
    disabled_ns: int


@dataclass(frozen=True, kw_only=True)
class AxisReport:
    """What the controller reports of one axis.

    Attributes:
        axis: The controller's name of it.
        direction: Which way of the stage it is.
        fault: Names of its latched faults; empty: there are none.
        moving: It moves.
        enabled: It is powered.
        position_m: Where it is, in the stage's coordinates.
        asked_ns: When it was asked: what was done since may not be in the answer.
        answered_ns: When it had answered where it is.
        following_m: How far it is from where it is sent.
    """

    axis: str
    direction: Direction
    fault: str
    moving: bool
    enabled: bool
    position_m: float
    asked_ns: int
    answered_ns: int
    following_m: float = 0.0


class StopLink(Protocol):
    """A second link to a stage's controller, the safety process's own: it stops and moves nothing."""

    @property
    def guarded(self) -> bool:
        """Whether another process stops the axes on this link as soon as this process is dead."""

    def reports(self) -> list[AxisReport]:
        """Return what the axes have answered since the last call, without waiting.

        Raises:
            DeviceError: They do not answer, or the link is lost: the rig must not move.
        """

    def poll(self) -> list[AxisReport]:
        """Ask every axis and wait for its answer; errors as above."""

    def abort(self) -> int:
        """Stop every axis past whatever is under way; return when that was written, in ns.

        Raises:
            DeviceError: The link is lost.
        """

    def finish_stop(self, written_ns: int) -> StopTimes:
        """Wait a little for rest after :meth:`abort`, then disable whatever was answered; errors as there."""

    def trip(self) -> StopTimes:
        """Abort and finish the stop; errors as there."""

    def close(self) -> None: ...


class OpenStopLink(Protocol):
    """Opens a second link to the controller of a stage, with that stage's axes, origin and signs."""

    def __call__(self, url: str, *, timeout_s: float, look_hz: float, clock: Callable[[], int]) -> StopLink:
        """Connect.

        Args:
            url: Address of the second link.
            timeout_s: Longest wait for an answer.
            look_hz: How often an axis is asked how it does.
            clock: Time in ns.

        Raises:
            DeviceError: Nothing answers there.
        """


class Device(Protocol[S]):
    """What every device is; nothing of a protocol is optional, and ``open_device`` refuses what lacks any."""

    LINK: ClassVar[str]
    """How it is reached, for a person."""

    @property
    def state_type(self) -> type[S]:
        """What it remembers: a type that serialises, whose default is a device that was never up."""

    def open(self, now_ns: int, state: S, rng: np.random.Generator) -> None: ...
    def close(self) -> None: ...
    def health(self, now_ns: int) -> DeviceHealth: ...


class Mover(Device[S], Protocol[S]):
    """A device that moves: it can be found without moving, and a person leads it out of a trip."""

    ADDRESS: ClassVar[str]
    """The options that say where it is, as a person types them."""

    def discover(self) -> dict[str, str]:
        """Return how the device does, as a text by what answered; nothing moves and nothing is enabled.

        Raises:
            DeviceError: It does not answer, or says what no such device says.
        """

    def acknowledge(self, now_ns: int, state: S) -> None:
        """Clear what stopped it, and enable again: a person's step, never the driver's own.

        Raises:
            DeviceError: The cause persists, or the link is lost.
        """


class StageOptions(msgspec.Struct, frozen=True, kw_only=True):
    """What a stage's node hands to every driver, by name; the launch file's ``options`` are the driver's own.

    Attributes:
        limits: Where the stage may go, and how fast.
        sweep_speed_m_per_s: Speed of a sweep.
        lift_speed_m_per_s: Speed of raising and lowering.
        lift_m: Height of the way back above the scanning height.
    """

    limits: TravelLimits = TravelLimits()
    sweep_speed_m_per_s: float = 0.020
    lift_speed_m_per_s: float = 0.020
    lift_m: float = 0.020


class StageDevice(Mover[S], Protocol[S]):
    """Sweep one way over the tissue at constant speed, and come back by another path.

    Its class takes the fields of :class:`StageOptions` by name, and options of its own.
    """

    @property
    def moves_across(self) -> bool:
        """Whether it has a third axis, x, across the sweep."""

    @property
    def stop_link(self) -> OpenStopLink | None:
        """What opens a second link to its controller; None: it has no second link."""

    def sweep_start(self, from_m: float, to_m: float) -> float:
        """Return the y from which a sweep over [from_m, to_m] has the room to reach its speed, in m."""

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: S) -> SweepTimes:
        """Sweep from here, at constant speed all the way from ``from_m`` to ``to_m``."""

    def return_to(
        self, y_m: float, now_ns: int, state: S, *, height_m: float = 0.0, across_m: float | None = None
    ) -> int:
        """Raise, go across to ``across_m`` and along to ``y_m``, lower to ``height_m`` above a sweep.

        It goes sideways only while the height that is **measured** is that of the way back. None: it stays
        where it is across.

        Returns:
            Time of arrival, ns.

        Raises:
            DeviceError: A place is outside of the limits, as any place across but 0 is without a third axis.
        """

    def retreat(self, speed_m_per_s: float, now_ns: int, state: S) -> int:
        """Raise the probe where it is; return the time of arrival in ns."""

    def stop(self, now_ns: int, state: S) -> int:
        """Decelerate to rest where it is, whatever it was doing; return the time of rest in ns."""

    def feedback(self, now_ns: int, state: S) -> StageFeedback:
        """Return what was measured last.

        Raises:
            DeviceError: The stage is not open.
        """

    def read(self, times_ns: Int64Array, state: S) -> StageReading: ...


class RingDevice(Mover[S], Protocol[S]):
    """Move the anchor ring, and with it the stiffness of the joint."""

    def command(self, target_m: float, now_ns: int, state: S, rng: np.random.Generator) -> int:
        """Go to ``target_m``; return the time at which it will have settled, in ns."""

    def rehome(self, now_ns: int, state: S, rng: np.random.Generator) -> int:
        """Drive to the retracted stop and back to the target; return the time of settling in ns."""

    def stop(self, now_ns: int, state: S) -> None:
        """Hold where it is, at once."""

    def read(self, now_ns: int, state: S) -> RingReading: ...


class TorqueSensor(Device[S], Protocol[S]):
    """Measure the torque between connecting and base link."""

    def drain(self, now_ns: int, state: S, rng: np.random.Generator) -> TorqueSamples:
        """Return every sample received since the last call; a simulated sensor is unloaded here."""

    def tare(self, block: TorqueSamples, state: S) -> Float64Array:
        """Make the mean of ``block``, read unloaded, the new zero; return what is subtracted from now on.

        Returns:
            Forces in N and torques in N m, shape (6,), or the torque of a one-axis source, shape (1,).
        """


class EmgDevice(Device[S], Protocol[S]):
    """Deliver the raw EMG of two muscles."""

    @property
    def rate_hz(self) -> float: ...

    def drain(self, now_ns: int, state: S, rng: np.random.Generator) -> EmgSamples:
        """Return every sample since the last call up to and including ``now_ns``."""


def restored(device: Device[S], kept: object) -> S:
    """Return a device's state from what its caller has kept.

    Args:
        device: Whose state it is.
        kept: The state itself; or the plain values that are left of one that was serialised; or None for a
            device that was never up.

    Raises:
        DeviceError: It is what another device remembered: that this one is homed or tared it does not say.
    """
    if isinstance(kept, device.state_type):
        return kept
    if kept is None:
        return device.state_type()
    try:
        state = msgspec.convert(kept, device.state_type)
    except (msgspec.ValidationError, TypeError) as error:
        raise _another_state(device, in_words(error)) from error
    if isinstance(kept, Mapping) and (strange := set(kept) ^ set(msgspec.to_builtins(state))):
        raise _another_state(device, f"they differ in {', '.join(sorted(map(str, strange)))}")
    return state


def _another_state(device: Device[S], why: str) -> DeviceError:
    wanted = device.state_type.__name__
    return DeviceError(
        f"{type(device).__name__} remembers {wanted}, and what was handed over is none: {why};"
        " stop the graph and start it with this device"
    )
