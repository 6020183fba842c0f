"""Limits that a driver checks before a command leaves, and that the watchdog checks on what is measured."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import Self

from palp_core.errors import DeviceError
from palp_core.palpation.nano17 import RANGE_N, RANGE_N_M

CLEARANCE_M = 0.5e-3
"""Least gap between raised probe and gel; assumed: five standard deviations of a mounting's height."""


def check_range(where: str, quantity: str, value: float, low: float, high: float) -> float:
    """Return ``value`` if it lies in [``low``, ``high``]; NaN never does."""
    if not low <= value <= high:
        raise DeviceError(f"{where}: {quantity} = {value:.9g} must lie in [{low:.9g}, {high:.9g}]")
    return value


def check_lift(lift_m: float, indentation_m: float) -> None:
    """Refuse a height of the way back at which the probe would still touch the gel."""
    check_range("stage", "lift_m", lift_m, 0.0, 1.0)
    needed_m = max(indentation_m, 0.0) + CLEARANCE_M
    if lift_m < needed_m - 1e-9:
        raise DeviceError(
            f"stage: raised by {lift_m * 1e3:g} mm the probe is dragged through the gel, which it enters by "
            f"{indentation_m * 1e3:g} mm where it scans; raise it by at least {needed_m * 1e3:g} mm"
        )


@dataclass(frozen=True)
class TravelLimits:
    """Where the stage may go and how fast.

    Attributes:
        y_m: Window along the sweep (the scene's path and a margin).
        z_m: Window above the scanning height.
        x_m: Window across the sweep; nothing but 0: the stage does not move across.
        speed_m_per_s: Fastest move, until the stage's variant is known.

    Raises:
        DeviceError: A window is empty or a limit is not finite.
    """

    y_m: tuple[float, float] = (-0.055, 0.055)
    z_m: tuple[float, float] = (0.0, 0.055)
    x_m: tuple[float, float] = (0.0, 0.0)
    speed_m_per_s: float = 0.050

    def __post_init__(self) -> None:
        for name, (low, high) in (("y_m", self.y_m), ("z_m", self.z_m), ("x_m", self.x_m)):
            check_range("stage", f"{name} low", low, -1.0, 1.0)
            check_range("stage", f"{name} high", high, low, 1.0)
        check_range("stage", "speed_m_per_s", self.speed_m_per_s, 1e-6, 0.350)

    @property
    def across(self) -> bool:
        """Whether the stage moves across the sweep."""
        return self.x_m != (0.0, 0.0)

    @classmethod
    def around(
        cls,
        from_m: float,
        to_m: float,
        margin_m: float,
        lift_m: float,
        speed_m_per_s: float = 0.050,
        *,
        across_m: tuple[float, float] = (0.0, 0.0),
    ) -> Self:
        """Return the window of sweeps: their path, the place of rest at 0, and a margin but for downwards.

        ``across_m`` is where the outermost lanes lie across the sweep; both 0: it does not move across.
        """
        check_range("stage", "margin_m", margin_m, 0.0, 0.1)
        low, high = min(from_m, to_m, 0.0) - margin_m, max(from_m, to_m, 0.0) + margin_m
        left_m, right_m = min(*across_m, 0.0), max(*across_m, 0.0)
        x_m = (left_m - margin_m, right_m + margin_m) if left_m < right_m else (0.0, 0.0)
        return cls((low, high), (0.0, lift_m + margin_m), x_m, speed_m_per_s)

    def sweep_end(
        self, y_m: float, z_m: float, from_m: float, to_m: float, run_up_m: float, there_m: float
    ) -> float:
        """Return the y at which a sweep from here ends, with its run-up behind the interval, too.

        Raises:
            DeviceError: The interval has no direction or leaves the window; or the stage is raised, or not
                far enough before the interval, by more than ``there_m``.
        """
        check_range("stage", "from_m", from_m, *self.y_m)
        check_range("stage", "to_m", to_m, *self.y_m)
        if from_m == to_m:
            raise DeviceError(f"stage: a sweep from {from_m:g} m to the same place has no direction")
        sign = math.copysign(1.0, to_m - from_m)
        start_m, end_m = from_m - sign * run_up_m, to_m + sign * run_up_m
        check_range("stage", "sweep's run-out y_m", end_m, *self.y_m)
        if z_m > there_m or sign * (y_m - start_m) > there_m:
            raise DeviceError(
                f"stage: at y = {y_m:g} m, z = {z_m:g} m there is no room to speed up before {from_m:g} m;"
                f" return_to(sweep_start(...)) = {start_m:g} m first"
            )
        return end_m

    def check_across(self, across_m: float) -> None:
        """Refuse a place across the sweep outside of the window, or any but 0 without a third axis."""
        if across_m != 0.0 and not self.across:
            raise DeviceError(
                f"stage: across_m = {across_m:.9g}: it moves along the sweep and up only; name its third"
                " axis, and give across_from_m and across_to_m to the nodes stage and safety"
            )
        check_range("stage", "across_m", across_m, *self.x_m)

    def check(self, axis: str, from_m: float, to_m: float, speed_m_per_s: float) -> None:
        """Refuse a straight move that leaves the window anywhere, or is too fast."""
        low, high = {"y": self.y_m, "z": self.z_m, "x": self.x_m}[axis]
        slack_m = 50e-6  # a feedback that jitters about the window's edge
        check_range("stage", f"{axis} of the start of a move, m", from_m, low - slack_m, high + slack_m)
        check_range("stage", f"{axis} of the end of a move, m", to_m, low, high)
        check_range("stage", "speed of a move, m/s", speed_m_per_s, 1e-9, self.speed_m_per_s)


class Level(IntEnum):
    """How serious a load is."""

    FINE = 0
    WARN = 1
    STOP = 2


@dataclass(frozen=True)
class WrenchLimits:
    """Loads at which to warn and to stop, for each force and torque alone.

    The torque binds: at a lever of 150 mm from the tip, 120 N mm are reached by 0.8 N.

    Attributes:
        warn_torque_n_m: Assumed.
        stop_torque_n_m: Assumed.
        warn_force_n: Assumed.
        stop_force_n: Assumed.
        range_torque_n_m: Largest torque that the sensor can measure (the maker's figure for SI-12-0.12).
        range_force_n: Largest force, likewise.

    Raises:
        DeviceError: A limit is not finite, a warning is above its stop, or a stop is above the sensor's
            range: it could never trip.
    """

    warn_torque_n_m: float = 0.080
    stop_torque_n_m: float = 0.100
    warn_force_n: float = 8.0
    stop_force_n: float = 10.0
    range_torque_n_m: float = RANGE_N_M
    range_force_n: float = RANGE_N

    def __post_init__(self) -> None:
        for load, ceiling in (("torque_n_m", 10.0), ("force_n", 1e3)):
            most, stop = getattr(self, f"range_{load}"), getattr(self, f"stop_{load}")
            check_range("limits", f"range_{load}", most, 0.0, ceiling)
            if stop > most * (1.0 + 1e-9):
                raise DeviceError(
                    f"limits: stop_{load} = {stop:g} is above the sensor's range of {most:g} and can never "
                    "trip; lower it, or state the range of the sensor that is mounted"
                )
            check_range("limits", f"stop_{load}", stop, 0.0, ceiling)
            check_range("limits", f"warn_{load}", getattr(self, f"warn_{load}"), 0.0, stop)

    def level(self, torque_n_m: Iterable[float], force_n: Iterable[float]) -> Level:
        """Return how serious the worst of some loads is; NaN is the worst."""
        torques, forces = [abs(torque) for torque in torque_n_m], [abs(force) for force in force_n]
        if not all(torque < self.stop_torque_n_m for torque in torques):
            return Level.STOP
        if not all(force < self.stop_force_n for force in forces):
            return Level.STOP
        over = any(torque >= self.warn_torque_n_m for torque in torques)
        return Level.WARN if over or any(force >= self.warn_force_n for force in forces) else Level.FINE


class DutyCycle:
    """Say when a motor that must rest may run again.

    Args:
        share: Largest share of any window that it runs (L12: 20 %).
        window_s: The window (assumed; the data sheet names none).

    Raises:
        DeviceError: An argument is out of range.
    """

    def __init__(self, share: float, window_s: float) -> None:
        check_range("duty cycle", "share", share, 1e-3, 1.0)
        check_range("duty cycle", "window_s", window_s, 1e-3, 1e5)
        self._budget_ns, self._window_ns = round(share * window_s * 1e9), round(window_s * 1e9)
        self._runs: deque[tuple[int, int]] = deque()

    def start_ns(self, now_ns: int, run_ns: int) -> int:
        """Return the first time from ``now_ns`` on at which a run of ``run_ns`` keeps within the budget."""
        check_range("duty cycle", "run_ns", run_ns, 0, self._budget_ns)
        while self._runs and self._runs[0][1] <= now_ns - self._window_ns:
            self._runs.popleft()
        latest_ns = max(now_ns, self._runs[-1][1] if self._runs else now_ns) + self._window_ns
        return self._refined(now_ns, latest_ns, run_ns)

    @property
    def runs(self) -> list[tuple[int, int]]:
        """Begin and end of the runs noted; a successor inherits them, as the motor is as warm for it."""
        return list(self._runs)

    def restore(self, runs: Iterable[tuple[int, int]]) -> None:
        """Note what ran before, and nothing else."""
        self._runs = deque(runs)

    def add_run(self, start_ns: int, end_ns: int) -> None:
        """Note a run."""
        self._runs.append((start_ns, end_ns))

    def end_run(self, now_ns: int) -> None:
        """End the last run now, or take it back if it has not begun: another command replaced it."""
        if self._runs and self._runs[-1][1] > now_ns:
            start_ns, _ = self._runs.pop()
            if start_ns < now_ns:
                self._runs.append((start_ns, now_ns))

    def _used_ns(self, at_ns: int) -> int:
        """Return the running time within the window that ends at a time, of the runs noted."""
        begin_ns = at_ns - self._window_ns
        return sum(max(0, min(end, at_ns) - max(start, begin_ns)) for start, end in self._runs)

    def _refined(self, low_ns: int, high_ns: int, run_ns: int) -> int:
        """Return the earliest fitting time between two, the later of which fits."""
        if self._used_ns(low_ns + run_ns) + run_ns <= self._budget_ns:
            return low_ns
        while high_ns - low_ns > 1_000_000:
            middle_ns = (low_ns + high_ns) // 2
            if self._used_ns(middle_ns + run_ns) + run_ns <= self._budget_ns:
                high_ns = middle_ns
            else:
                low_ns = middle_ns
        return high_ns
