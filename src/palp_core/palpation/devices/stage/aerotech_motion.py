"""Motion on an Aerotech controller: its axes, the legs of a path, the thread that sends them and watches."""

import math
import threading
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.serial_link import LinkLost
from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink, CommandRefused
from palp_core.palpation.devices.stage.position_history import PositionHistory
from palp_core.palpation.devices.wire import aerotech as wire

_TRIES = 3
_REST_S = 2.0
_ENABLING_S = 1.0  # amplifiers take their time (assumed), and meanwhile nothing moves
_THERE_MM = 0.1  # how far off a leg may end (assumed; a controller in position is much closer)
_RECOVERS = (Condition.OK, Condition.STALE, Condition.GARBLED, Condition.LINK_LOST)


@dataclass(frozen=True)
class Leg:
    """One straight move of one axis, in the controller's units, and its length.

    ``lift_mm`` is between which positions the lifting axis must be measured all the way; None: anywhere.
    """

    axis: str
    start_mm: float
    target_mm: float
    speed_mm_per_s: float
    length_m: float
    lift_mm: tuple[float, float] | None = None

    @property
    def command(self) -> bytes:
        """The bytes that start it."""
        return wire.move(self.axis, self.target_mm, self.speed_mm_per_s)


def in_segments(legs: Iterable[Leg], longest_m: float) -> list[Leg]:
    """Return legs in parts of at most ``longest_m`` (0: whole), each of which ends at rest.

    The process that commands them may die: the stage then rests at the end of a part.
    """
    parts: list[Leg] = []
    for leg in legs:
        count = max(1, math.ceil(leg.length_m / longest_m - 1e-9)) if longest_m > 0.0 else 1
        step_mm = (leg.target_mm - leg.start_mm) / count
        for k in range(1, count + 1):
            start_mm, target_mm = leg.start_mm + (k - 1) * step_mm, leg.start_mm + k * step_mm
            last = leg.target_mm if k == count else target_mm
            parts.append(replace(leg, start_mm=start_mm, target_mm=last, length_m=leg.length_m / count))
    return parts


def duration_s(legs: Iterable[Leg], accel_m_per_s2: float, settle_s: float) -> float:
    """Return how long legs take one after another, with an allowance for each."""

    def one(leg: Leg) -> float:
        profile = MotionProfile(0.0, leg.length_m, leg.speed_mm_per_s * 1e-3, accel_m_per_s2, 0)
        return profile.end_ns * 1e-9 + settle_s

    return sum(one(leg) for leg in legs)


class ControllerAxes:
    """The axes as the controller has them: enabled, homed, at fault, moving, and where."""

    def __init__(self, link: AerotechLink, names: tuple[str, ...], host: HostTime) -> None:
        self.names = names
        self._link, self._host = link, host
        self._abort = wire.each("ABORT", names)

    def enable(self) -> None:
        """Enable every axis."""
        for axis in self.names:
            fault = self.fault(axis)
            if fault:
                raise DeviceError(
                    f"stage: axis {axis} has a latched fault: {fault.words}; clear the cause,"
                    " then acknowledge it at the controller (FAULTACK) before opening"
                )
            self._link.do(wire.command(f"ENABLE {axis}"), _ENABLING_S)
        self._link.do(wire.command("WAIT MODE NOWAIT"))

    def acknowledge(self) -> None:
        """Clear the latched faults and enable."""
        for axis in self.names:
            self._link.do(wire.command(f"FAULTACK {axis}"), _ENABLING_S)
        self.enable()

    def homed(self) -> bool:
        """Return whether every axis knows where it is."""
        return all(self.status(axis) & wire.AxisStatus.HOMED for axis in self.names)

    def home(self, timeout_s: float, period_s: float) -> None:
        """Home the lifting axis, then the others.

        Of all motion only this ends when the controller alone decides. Whatever ends it early also stops it,
        as it would go on unwatched.
        """
        try:
            for axis in (self.names[1], self.names[0], *self.names[2:]):
                self._home(axis, timeout_s, period_s)
        except BaseException:
            with suppress(DeviceError):
                self.abort()
            raise

    def abort(self) -> None:
        """Send ABORT for every axis past whatever is under way."""
        self._link.send_at_once(self._abort)

    def status(self, axis: str) -> int:
        """Return the bits of :class:`wire.AxisStatus` of an axis."""
        return self._link.bits(f"AXISSTATUS({axis})")

    def fault(self, axis: str) -> wire.Fault:
        """Return the latched faults of an axis."""
        return wire.Fault(self._link.bits(f"AXISFAULT({axis})"))

    def moving(self) -> bool:
        """Return whether an axis moves."""
        return any(self.status(axis) & wire.AxisStatus.MOVING for axis in self.names)

    def poll_positions(self, history: PositionHistory) -> None:
        """Ask where the axes are, in mm, and add it, stamped in the middle of the first exchange."""
        asked_ns = self._host.now_ns()
        first_mm = self._link.number(f"PFBKPROG({self.names[0]})")
        error_ns = (self._host.now_ns() - asked_ns) // 2
        others_mm = [self._link.number(f"PFBKPROG({axis})") for axis in self.names[1:]]
        history.append(asked_ns + error_ns, (first_mm, *others_mm), error_ns, self._host.now_ns())

    def _home(self, axis: str, timeout_s: float, period_s: float) -> None:
        self._link.do(wire.command(f"HOMEASYNC {axis}"), _ENABLING_S)
        pause, until_ns = threading.Event(), self._host.now_ns() + round(timeout_s * 1e9)
        while True:
            status = self.status(axis)
            if status & wire.AxisStatus.HOMED and not status & (
                wire.AxisStatus.HOMING | wire.AxisStatus.MOVING
            ):
                return
            if not status & wire.AxisStatus.ENABLED:
                raise DeviceError(f"stage: axis {axis} was disabled while it homed")
            if self._host.now_ns() > until_ns:
                raise DeviceTimeout(f"stage: axis {axis} did not home within {timeout_s:g} s")
            pause.wait(period_s)


class Motion:
    """Poll the axes, send leg after leg, stop at the first sign of trouble.

    Attributes:
        history: Where the axes were at the polls, in mm.
    """

    def __init__(
        self, link: AerotechLink, axes: ControllerAxes, host: HostTime, monitor: HealthMonitor, poll_hz: float
    ) -> None:
        self._link, self._axes, self._host, self._monitor = link, axes, host, monitor
        self._period_s = 1.0 / poll_hz
        self.history = PositionHistory()
        self._legs: deque[Leg] = deque()
        self._active: Leg | None = None
        self._starting = self._aborting = False
        self._turn = self._failures = self._aborts = 0
        self._change, self._stop = threading.Condition(), threading.Event()
        self._judging = threading.Lock()  # no poll from before an acknowledgement is judged after it
        self._thread = threading.Thread(target=self._run, name="palp-aerotech", daemon=True)

    @property
    def busy(self) -> bool:
        """Whether legs are under way or waiting."""
        return self._starting or self._aborting or self.on_leg or bool(self._legs)

    @property
    def on_leg(self) -> bool:
        """Whether a leg is under way."""
        return self._active is not None

    def start(self) -> None:
        """Stop what may still move from before, wait for rest, and begin to poll."""
        self._axes.abort()
        until_ns = self._host.now_ns() + round(_REST_S * 1e9)
        self._aborting = True
        while self._aborting:
            if self._host.now_ns() > until_ns:
                raise DeviceTimeout(f"stage: moves still {_REST_S:g} s after ABORT; check the controller")
            self._see_rest()
        self._axes.poll_positions(self.history)
        self._monitor.note_data(self._host.now_ns())
        self._thread.start()

    def stop_polling(self) -> None:
        """End the thread and close the link."""
        self._stop.set()
        self._thread.join()
        self._link.close()
        self._monitor.report(Condition.CLOSED, self._host.now_ns())

    def acknowledge(self) -> None:
        """Clear faults, enable, and let the next good poll end the trip."""
        with self._judging:
            self._forget_legs()
            self._axes.acknowledge()
            self._monitor.note_data(self._host.now_ns())

    def follow(self, legs: list[Leg]) -> int:
        """Send the first leg now and the others one after another; return when the first started, in ns.

        Raises:
            DeviceError: The first leg needs another height than is measured now; or the link fails.
        """
        with self._change:
            if self.busy:
                raise DeviceError("stage: moves; wait for the end or stop it first")
            if not legs:
                return self._host.now_ns()
            self._starting, aborts = True, self._aborts
            self._legs.extend(legs[1:])
        try:
            if legs[0].lift_mm is not None:
                self._axes.poll_positions(self.history)
                if low := self._lowered(legs[0]):
                    raise DeviceError(f"stage: {low}; raise it first")
            self._send(legs[0], aborts)
        except DeviceError:
            self._forget_legs()
            raise
        finally:
            self._starting = False
        return self._host.now_ns()

    def abort(self) -> None:
        """Stop every axis past whatever is under way, and forget the legs."""
        self._forget_legs()
        self._aborting = True
        self._axes.abort()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the end of all legs; abort them if it does not come; return whether it came, in health."""
        with self._change:
            done = self._change.wait_for(lambda: not self.busy, timeout_s)
        if not done:
            with suppress(DeviceError):
                self.abort()
        return done and self._monitor.read(self._host.now_ns()).ok

    def _run(self) -> None:
        while not self._stop.is_set():
            began_ns = self._host.now_ns()
            try:
                with self._judging:
                    self._poll()
                self._failures = 0
            except CommandRefused as error:
                self._trouble(Condition.DEVICE_FAULT, str(error))
            except DeviceTimeout as error:
                self._failed(Condition.STALE, str(error))
            except LinkLost as error:
                self._trouble(Condition.LINK_LOST, str(error))
            except DeviceError as error:
                self._failed(Condition.GARBLED, str(error))
            spent_s = (self._host.now_ns() - began_ns) * 1e-9
            self._stop.wait(max(0.0, self._period_s - spent_s))

    def _poll(self) -> None:
        self._link.require_guard()
        self._axes.poll_positions(self.history)
        active, names = self._active, self._axes.names
        axis = active.axis if active else names[self._turn % len(names)]
        status = self._axes.status(axis)
        self._turn += 1
        watched = names[self._turn // 2 % len(names)] if status & wire.AxisStatus.ENABLED else axis
        fault = self._axes.fault(watched)
        now_ns = self._host.now_ns()
        if self._aborting:
            self._see_rest()
        low = self._lowered(active) if active is not None and active is self._active else ""
        if fault:
            self._trouble(_condition_of(fault), f"axis {watched}: {fault.words}")
        elif not status & wire.AxisStatus.ENABLED:
            self._trouble(Condition.DISABLED, f"axis {axis} is disabled, and not by this driver")
        elif low:
            self._trouble(Condition.DEVICE_FAULT, low)
        else:
            recovers = self._monitor.read(now_ns).condition in _RECOVERS
            (self._monitor.note_data if recovers else self._monitor.note_contact)(now_ns)
            if active is not None and not status & wire.AxisStatus.MOVING:
                self._next(active)

    def _see_rest(self) -> None:
        """Notice that every axis has come to rest after an abort."""
        if not self._axes.moving():
            with self._change:
                self._aborting = False
                self._change.notify_all()

    def _next(self, done: Leg) -> None:
        """Start the next leg once the plane agrees that the last has ended, and only from its end."""
        if self._link.bits("PLANESTATUS(0)") & wire.Plane.MOVING:
            return
        self._axes.poll_positions(self.history)
        off_mm = abs(self.history.last[self._axes.names.index(done.axis)] - done.target_mm)
        with self._change:
            if self._active is not done:  # aborted meanwhile
                return
            if there := off_mm <= _THERE_MM:
                self._active = None
                following, aborts = self._legs.popleft() if self._legs else None, self._aborts
                self._starting = following is not None
                self._change.notify_all()
        if not there:  # from here the way is another one
            words = f"axis {done.axis} rests {off_mm:.2f} mm from where it was sent"
            self._trouble(Condition.DISABLED, f"{words}: stopped, and not by this driver")
            return
        try:
            if following is not None and (low := self._lowered(following)):
                self._trouble(Condition.DEVICE_FAULT, low)
            elif following is not None:
                self._send(following, aborts)
        finally:
            self._starting = False

    def _lowered(self, leg: Leg) -> str:
        """Return how the height measured last forbids a leg; empty: it does not."""
        if leg.lift_mm is None or leg.lift_mm[0] <= (at_mm := self.history.last[1]) <= leg.lift_mm[1]:
            return ""
        return (
            f"axis {self._axes.names[1]} is at {at_mm:.2f} mm, not raised, where axis {leg.axis} is to move"
        )

    def _send(self, leg: Leg, aborts: int) -> None:
        """Start a leg, and stop it again if somebody aborted in the meantime."""
        try:
            self._link.do(leg.command)
        except DeviceError:  # it may have begun all the same, and after somebody's ABORT
            with suppress(DeviceError):
                self._axes.abort()
            raise
        with self._change:
            if self._aborts == aborts:
                self._active = leg
                return
        self._axes.abort()
        raise DeviceError("stage: stopped while a move began")

    def _failed(self, condition: Condition, cause: str) -> None:
        """Take up to two bad answers in a row as noise on the line."""
        self._failures += 1
        if self._failures >= _TRIES or condition is Condition.STALE:
            self._trouble(condition, cause)

    def _trouble(self, condition: Condition, cause: str) -> None:
        """Enter a condition, send no further leg, and stop what is still under way."""
        was_busy = self.busy and not self._aborting
        self._monitor.report(condition, self._host.now_ns(), cause)  # first: who sees it at rest sees why
        self._forget_legs()
        if condition is Condition.LINK_LOST:
            self._aborting = False
        elif was_busy:
            self._aborting = True
            with suppress(DeviceError):
                self._axes.abort()

    def _forget_legs(self) -> None:
        with self._change:
            self._aborts += 1
            self._legs.clear()
            self._active = None
            self._change.notify_all()


def _condition_of(fault: wire.Fault) -> Condition:
    """Return the name of the state that latched faults mean."""
    if fault & wire.Fault.E_STOP:
        return Condition.E_STOP
    if fault & wire.Fault.LIMITS:
        return Condition.LIMIT
    return Condition.DEVICE_FAULT


def axis_in_words(link: AerotechLink, axis: str) -> str:
    """Return how an axis does; nothing but questions is sent."""
    status = wire.AxisStatus(link.bits(f"AXISSTATUS({axis})"))
    fault = wire.Fault(link.bits(f"AXISFAULT({axis})"))
    words = [
        "enabled" if status & wire.AxisStatus.ENABLED else "disabled",
        "homed" if status & wire.AxisStatus.HOMED else "not homed",
        "moving" if status & wire.AxisStatus.MOVING else "at rest",
        f"at {link.number(f'PFBKPROG({axis})'):g} mm",
        f"fault {fault.words}",
    ]
    try:
        low, high = (
            link.number(f"GETPARM({axis}, {number})")
            for number in (wire.Parameter.SOFT_LIMIT_LOW, wire.Parameter.SOFT_LIMIT_HIGH)
        )
        words.append(f"soft limits {low:g} to {high:g} mm")
    except CommandRefused:
        words.append("does not report its soft limits")
    return ", ".join(words)
