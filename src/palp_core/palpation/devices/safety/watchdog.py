"""What the safety process checks on everything it hears, without a node or a link in sight."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from palp_core.palpation.devices.limits import Level, TravelLimits, WrenchLimits, check_range
from palp_core.palpation.devices.safety.state_machine import Cause

_GOOD = ("ok", "")
_LINK = ("link lost", "stale", "garbled")


class LimitViolation(NamedTuple):
    """A limit that is passed: which, and a text with the numbers."""

    cause: Cause
    text: str


@dataclass(frozen=True)
class WatchLimits:
    """Limits of the watch. The window and the speed stand for the scene and the stage; the rest is assumed.

    The text of a limit that is passed names the safety node's parameter that sets it, if one does.

    Attributes:
        wrench: Loads at which to warn and to stop.
        travel: Where the stage may be and how fast, as its driver has it.
        raised_m: Height from which on the stage may move across: that of the way back.
        slack_m: How far beyond the driver's window, below that height, or across while lowered is a trip: the
            driver stops before.
        speed_share: How much faster than the driver's limit is a trip: speeds are differences of polls.
        following_m: Largest difference of commanded and measured position.
        stale_s: Longest time without a sample while motion is permitted.
        beat_s: Longest time without a report of sensor, stage or ring, or without the watch itself running.
        bring_up_s: As much while the stage homes.
    """

    wrench: WrenchLimits = field(default_factory=WrenchLimits)
    travel: TravelLimits = field(default_factory=TravelLimits)
    raised_m: float = 0.020
    slack_m: float = 0.5e-3
    speed_share: float = 1.25
    following_m: float = 0.5e-3
    stale_s: float = 0.025
    beat_s: float = 0.050
    bring_up_s: float = 70.0

    @property
    def fastest_m_per_s(self) -> float:
        """Speed above which the stage trips."""
        return self.travel.speed_m_per_s * self.speed_share

    def __post_init__(self) -> None:
        for name, low, high in (
            ("raised_m", 0.0, 1.0),
            ("slack_m", 0.0, 0.01),
            ("speed_share", 1.0, 10.0),
            ("following_m", 1e-6, 0.01),
            ("stale_s", 1e-3, 10.0),
            ("beat_s", 1e-3, 10.0),
            ("bring_up_s", 1e-3, 600.0),
        ):
            check_range("safety", name, getattr(self, name), low, high)


@dataclass(frozen=True)
class WatchedLoad:
    """The largest load since the last report, and when the latest sample was taken and reported."""

    sample_ns: int
    torque_n_m: float
    force_n: float
    saturated: bool = False
    faulty: bool = False
    condition: str = "ok"
    stamp_ns: int = 0


@dataclass(frozen=True)
class WatchedStage:
    """Where the stage is, how fast, and how it does; ``released``: it has taken note of the last release."""

    stamp_ns: int
    y_m: float
    z_m: float
    speed_m_per_s: float
    moving: bool
    bring_up: bool = False
    released: bool = True
    condition: str = "ok"
    text: str = ""
    x_m: float = 0.0


class Watchdog:
    """Keep the latest report of everything that is watched, and find what is wrong with it.

    ``arm`` forgets all reports: after a release each must come again before anything moves.
    """

    def __init__(self, limits: WatchLimits) -> None:
        self.limits = limits
        self.warning = ""
        self.arm()

    def arm(self) -> None:
        """Forget all reports."""
        self._sample_ns = self._load_ns = self._stage_ns = self._ring_ns = 0
        self._run_ns = self._judges_ns = 0
        self._bring_up = self._hears_first = False
        self._lowered_x_m: float | None = None

    @property
    def reported_ns(self) -> dict[str, int]:
        """When each that is watched reported last, by what it is; 0: not yet."""
        return {
            "sensor's node": self._load_ns,
            "torque samples": self._sample_ns,
            "stage's node": self._stage_ns,
            "ring's node": self._ring_ns,
        }

    def check_load(self, load: WatchedLoad) -> list[LimitViolation]:
        """Take note of a load; return what is wrong with it."""
        limits, found = self.limits.wrench, []
        fresh = load.sample_ns > self._sample_ns  # silence does not take a load away
        if load.sample_ns:
            self._sample_ns = max(self._sample_ns, load.sample_ns)
        self._load_ns = max(self._load_ns, load.stamp_ns or load.sample_ns)
        if load.saturated:
            found.append(LimitViolation(Cause.SATURATED, "a gauge of the sensor is at the end of its range"))
        if load.faulty or load.condition == "device fault":
            found.append(LimitViolation(Cause.SENSOR_FAULT, f"the sensor says of its data: {load.condition}"))
        if not math.isfinite(load.torque_n_m) or not math.isfinite(load.force_n):
            found.append(LimitViolation(Cause.SENSOR_FAULT, "a load is not a number"))
        elif limits.level((load.torque_n_m,), (load.force_n,)) is Level.STOP:
            torque = load.torque_n_m >= limits.stop_torque_n_m
            text = f"{load.torque_n_m * 1e3:.1f} N mm, {load.force_n:.2f} N"
            stop = (
                f"{limits.stop_torque_n_m * 1e3:g} N mm (stop_n_mm)"
                if torque
                else f"{limits.stop_force_n:g} N (stop_n)"
            )
            text += f", the limit is {stop}"
            found.append(LimitViolation(Cause.TORQUE if torque else Cause.FORCE, text))
        if fresh:
            self.warning = self._warning(load)
        return found

    def check_stage(self, stage: WatchedStage) -> list[LimitViolation]:
        """Take note of the stage's report; return what is wrong with it."""
        travel, slack = self.limits.travel, self.limits.slack_m
        self._bring_up = stage.bring_up
        if stage.released:
            self._stage_ns = max(self._stage_ns, stage.stamp_ns)
        found = []
        for axis, place, (low, high) in (
            ("y", stage.y_m, travel.y_m),
            ("z", stage.z_m, travel.z_m),
            ("x", stage.x_m, travel.x_m),
        ):
            if stage.moving and not stage.bring_up and not low - slack <= place <= high + slack:
                window = f"outside of {low * 1e3:.1f} to {high * 1e3:.1f} mm"
                found.append(LimitViolation(Cause.TRAVEL, f"{axis} = {place * 1e3:.2f} mm, {window}"))
        found += self._check_across(stage)
        if not stage.bring_up and not abs(stage.speed_m_per_s) <= self.limits.fastest_m_per_s:
            limit = f"the limit is {travel.speed_m_per_s * 1e3:g} mm/s (speed_m_s)"
            text = f"{stage.speed_m_per_s * 1e3:.1f} mm/s, {limit}"
            found.append(LimitViolation(Cause.SPEED, text))
        if stage.released and stage.condition not in (*_GOOD, "closed"):
            cause = Cause.LINK_LOST if stage.condition in _LINK else Cause.AXIS_FAULT
            cause = Cause.HEARTBEAT if stage.condition == "no heartbeat" else cause
            found.append(LimitViolation(cause, _joined("the stage says", stage.condition, stage.text)))
        return found

    def _check_across(self, stage: WatchedStage) -> list[LimitViolation]:
        """Judge whether the stage moves across while the probe is not raised."""
        raised_m, slack_m = self.limits.raised_m, self.limits.slack_m
        if stage.bring_up or stage.z_m >= raised_m - slack_m:
            self._lowered_x_m = None
        elif self._lowered_x_m is None or not stage.moving:
            self._lowered_x_m = stage.x_m
        elif not abs(stage.x_m - self._lowered_x_m) <= slack_m:
            text = f"x = {stage.x_m * 1e3:.2f} mm, lowered at x = {self._lowered_x_m * 1e3:.2f} mm"
            text += f": across it may move from z = {raised_m * 1e3:g} mm on (lift_mm)"
            return [LimitViolation(Cause.TRAVEL, f"{text}, not at {stage.z_m * 1e3:.2f} mm")]
        return []

    def check_ring(
        self, stamp_ns: int, condition: str, text: str = "", *, released: bool = True
    ) -> list[LimitViolation]:
        """Take note of the ring's report; return what is wrong with it.

        One that has not noted the last release reports what was before it, and may be busy leaving it.
        """
        if not released:
            return []
        self._ring_ns = max(self._ring_ns, stamp_ns)
        if condition in (*_GOOD, "closed"):
            return []
        cause = Cause.LINK_LOST if condition in _LINK else Cause.RING_FAULT
        return [LimitViolation(cause, _joined("the ring's driver says", condition, text))]

    def check_axis(self, axis: str, fault: str, following_m: float) -> list[LimitViolation]:
        """Judge what an axis says on the safety process's own link."""
        found = [LimitViolation(Cause.AXIS_FAULT, f"axis {axis}: {fault}")] if fault else []
        if not abs(following_m) <= self.limits.following_m:
            text = f"axis {axis} is {following_m * 1e3:.2f} mm away from where it is sent"
            text += f", the limit is {self.limits.following_m * 1e3:g} mm (following_mm)"
            found.append(LimitViolation(Cause.FOLLOWING, text))
        return found

    def check_itself(self, now_ns: int, period_s: float) -> list[LimitViolation] | None:
        """Note that the watch runs; return why it was kept from it, and None if its queue comes first.

        A watch that comes late has not read what waits in its queue: it judges two periods later, not now.
        Being late itself for longer than a heartbeat is a reason of its own to stop, as nothing was watched
        meanwhile.
        """
        before_ns, self._run_ns = self._run_ns, now_ns
        late_s = (now_ns - before_ns) * 1e-9 - period_s if before_ns else 0.0
        if late_s > self.limits.beat_s:
            text = f"the watch itself was kept from running for {late_s * 1e3:.0f} ms"
            limit = f"the limit is {self.limits.beat_s * 1e3:g} ms (beat_ms)"
            return [LimitViolation(Cause.LATE, f"{text}, {limit}")]
        if late_s > period_s and not self._hears_first:
            self._hears_first, self._judges_ns = True, now_ns + round(2e9 * period_s)
        if now_ns < self._judges_ns:
            return None
        self._hears_first = False  # it judges now, before it may be excused again: it may be late for ever
        return []

    def overdue(self, now_ns: int) -> list[LimitViolation]:
        """Return what has not reported for too long; empty while motion may go on.

        A sensor that is silent while its node speaks is stale; a node that does not speak has lost its
        heartbeat, whatever its device does.
        """
        limits = self.limits
        stale, beat = (limits.stale_s, " (stale_ms)"), (limits.beat_s, " (beat_ms)")
        stage = (limits.bring_up_s, " while it homes") if self._bring_up else beat
        return [
            LimitViolation(
                cause, f"{name}: {self._age(now_ns, last_ns)}, the limit is {longest_s * 1e3:g} ms{of}"
            )
            for name, cause, last_ns, (longest_s, of) in (
                ("last report of the sensor", Cause.HEARTBEAT, self._load_ns, stale),
                ("last torque sample", Cause.STALE, self._sample_ns, stale),
                ("last report of the stage", Cause.HEARTBEAT, self._stage_ns, stage),
                ("last report of the ring", Cause.HEARTBEAT, self._ring_ns, beat),
            )
            if not last_ns or abs(now_ns - last_ns) > longest_s * 1e9  # nor may a stamp lie ahead
        ]

    @staticmethod
    def _age(now_ns: int, last_ns: int) -> str:
        return f"{(now_ns - last_ns) * 1e-6:.0f} ms ago" if last_ns else "none yet"

    def _warning(self, load: WatchedLoad) -> str:
        limits = self.limits.wrench
        if load.torque_n_m >= limits.warn_torque_n_m:
            return (
                f"torque of {load.torque_n_m * 1e3:.0f} N mm; the stop is at {limits.stop_torque_n_m * 1e3:g}"
            )
        if load.force_n >= limits.warn_force_n:
            return f"force of {load.force_n:.1f} N; the stop is at {limits.stop_force_n:g}"
        return ""


def _joined(*parts: str) -> str:
    return ": ".join(part for part in parts if part)
