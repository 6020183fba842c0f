"""The rod's moves: the thread that commands, reads the feedback, and notices arrival and stalls."""

import threading
from collections import deque
from typing import Protocol

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.serial_link import LinkLost
from palp_core.palpation.devices.ring.maestro_link import MaestroLink
from palp_core.palpation.devices.wire import maestro as wire

_TRIES = 3
_PROGRESS_M = 0.15e-3  # two counts of the feedback
_BEYOND_M = 3e-3  # how far past its ends a calibrated rod may seem to be (assumed)
_FASTEST_M_PER_S, _JITTER_M = 10e-3, 1e-3  # no L12 is faster (data sheet: 6.5 mm/s); noise (assumed)


class Rod(Protocol):
    """What the motion must know of the ring's parameters."""

    servo: int
    feedback: int
    arrived_m: float
    arrived_count: int
    stall_s: float
    poll_hz: float
    stroke_m: float
    zero_m: float

    def quarter_us(self, ring_m: float) -> int: ...
    def ring_m(self, counts: int) -> float: ...


class RodMotion:
    """Poll the feedback; drive to one target after another."""

    def __init__(self, link: MaestroLink, rod: Rod, host: HostTime, monitor: HealthMonitor) -> None:
        self._link, self._rod, self._host, self._monitor = link, rod, host, monitor
        self._targets: deque[float] = deque()
        self._active_m: float | None = None
        self._start_ns = 0
        self._near_count = self._failures = self._turn = 0
        self._progress_m, self._progress_ns = 0.0, 0
        self._seen_ns = 0
        self._held_m: float | None = None
        self._change = threading.Condition()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="palp-maestro", daemon=True)
        self.measured_m = 0.0
        self.arrived = False
        self.holding = False

    def start(self) -> None:
        """Read a first position and begin to poll."""
        self._read_position()
        self._monitor.note_data(self._host.now_ns())
        self._thread.start()

    def stop_polling(self) -> None:
        """End the thread and close the link."""
        self._stop.set()
        self._thread.join()
        self._link.close()
        self._monitor.report(Condition.CLOSED, self._host.now_ns())

    def follow(self, targets_m: list[float], start_ns: int) -> None:
        """Go to each target in turn, not before a time."""
        with self._change:
            self._targets = deque(targets_m)
            self._active_m, self._start_ns, self._held_m = None, start_ns, None
            self.arrived = self.holding = False

    def waits_ns(self, now_ns: int) -> int:
        """Return for how long the next move may not begin yet; 0 while one is under way, or none is wanted.

        Without the lock, under which the other thread may wait for the line.
        """
        return max(self._start_ns - now_ns, 0) if self._targets and self._active_m is None else 0

    def resume(self, target_m: float) -> None:
        """Take up from a driver before: the rod rests at its target, or was left elsewhere."""
        self.arrived = abs(self.measured_m - target_m) < self._rod.arrived_m
        self.holding = not self.arrived

    def hold(self) -> None:
        """Make the place where the rod is its target; called again it keeps that place."""
        with self._change:
            moving = not self.arrived
            self._targets.clear()
            self._active_m = None
            self.holding |= moving
            if moving:
                self._held_m = self.measured_m if self._held_m is None else self._held_m
                self._link.command(wire.set_target(self._rod.servo, self._rod.quarter_us(self._held_m)))
            self._change.notify_all()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the arrival at the last target; return whether it came."""
        with self._change:
            self._change.wait_for(lambda: self.arrived or self.holding, timeout_s)
        return self.arrived

    def acknowledge(self) -> None:
        """Read and clear the error word; the next good poll ends the condition."""
        self._link.errors()
        self._monitor.note_data(self._host.now_ns())

    def _run(self) -> None:
        while not self._stop.is_set():
            began_ns = self._host.now_ns()
            try:
                self._poll()
                self._failures = 0
            except DeviceTimeout as error:
                self._failed(Condition.STALE, str(error))
            except LinkLost as error:
                self._failed(Condition.LINK_LOST, str(error))
            except DeviceError as error:
                self._failed(Condition.GARBLED, str(error))
            self._stop.wait(max(0.0, 1.0 / self._rod.poll_hz - (self._host.now_ns() - began_ns) * 1e-9))

    def _poll(self) -> None:
        self._read_position()
        now_ns = self._host.now_ns()
        self._turn += 1
        error = self._link.errors() if self._turn % 5 == 0 else wire.Error(0)
        if error:
            self._halt(Condition.DEVICE_FAULT, f"the Maestro reports: {error.words}")
            return
        if self._monitor.read(now_ns).condition in (
            Condition.OK,
            Condition.STALE,
            Condition.LINK_LOST,
            Condition.GARBLED,
        ):
            self._monitor.note_data(now_ns)
        else:
            self._monitor.note_contact(now_ns)
        with self._change:
            self._advance(now_ns)

    def _read_position(self) -> None:
        """Read where the rod is; what no rod does is not believed: holding there would drive it."""
        counts, now_ns, rod = self._link.position(self._rod.feedback), self._host.now_ns(), self._rod
        place_m = rod.ring_m(counts)
        way_m = abs(place_m - self.measured_m) if self._seen_ns else 0.0
        why = ""
        if counts > wire.LARGEST_INPUT:
            why = f"beyond {wire.LARGEST_INPUT}; check the line"
        elif not -_BEYOND_M <= place_m + rod.zero_m <= rod.stroke_m + _BEYOND_M:
            why = f"{(place_m + rod.zero_m) * 1e3:.1f} mm of its stroke; check its lead and the calibration"
        elif way_m > _JITTER_M + _FASTEST_M_PER_S * (now_ns - self._seen_ns) * 1e-9:
            why = f"{way_m * 1e3:.1f} mm from where the rod was just now; check its lead"
        if why:
            self._link.mark_out_of_step()
            raise DeviceError(f"maestro: feedback of {counts}, {why}")
        self.measured_m, self._seen_ns = place_m, now_ns

    def _advance(self, now_ns: int) -> None:
        """Start what is due; see whether the rod is there, or stuck."""
        if self._active_m is None:
            if self._targets and now_ns >= self._start_ns:
                self._active_m = self._targets.popleft()
                self._near_count, self._progress_m, self._progress_ns = 0, self.measured_m, now_ns
                self._link.command(wire.set_target(self._rod.servo, self._rod.quarter_us(self._active_m)))
            return
        if abs(self.measured_m - self._active_m) < self._rod.arrived_m:
            self._near_count += 1
            if self._near_count >= self._rod.arrived_count:
                self._active_m = None
                self.arrived = not self._targets
                self._change.notify_all()
            return
        self._near_count = 0
        if abs(self.measured_m - self._progress_m) >= _PROGRESS_M:
            self._progress_m, self._progress_ns = self.measured_m, now_ns
        elif now_ns - self._progress_ns > self._rod.stall_s * 1e9:
            at_mm, to_mm = self.measured_m * 1e3, self._active_m * 1e3
            cause = f"at {at_mm:.2f} mm on the way to {to_mm:.2f} mm for {self._rod.stall_s:g} s"
            self._halt(Condition.STALLED, cause)

    def _failed(self, condition: Condition, cause: str) -> None:
        """Take up to two bad answers in a row as noise on the line."""
        self._failures += 1
        self._turn = 0  # the error word is asked for in good times only: a late reply could pass for it
        if self._failures >= _TRIES or condition is Condition.LINK_LOST:
            self._halt(condition, cause)

    def _halt(self, condition: Condition, cause: str) -> None:
        self._monitor.report(condition, self._host.now_ns(), cause)
        if condition is Condition.LINK_LOST:
            with self._change:
                self._targets.clear()
                self._active_m = None
                self.holding |= not self.arrived
                self._change.notify_all()
            return
        try:
            self.hold()
        except DeviceError:
            return
