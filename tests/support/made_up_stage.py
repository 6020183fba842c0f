"""A stage of another maker: a driver is one file, such as this."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import msgspec
import numpy as np

from palp_core.palpation.devices.health import HEALTHY, DeviceHealth
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.protocols import (
    AxisReport,
    Int64Array,
    StageFeedback,
    StageReading,
    StopTimes,
    SweepTimes,
)

RAISED_M = 0.020


class MadeUpState(msgspec.Struct):
    """One straight way in y at a height: it knows no acceleration. It came up ``open_count`` times."""

    open_count: int = 0
    start_ns: int = 0
    end_ns: int = 1
    from_m: float = 0.0
    to_m: float = 0.0
    z_m: float = RAISED_M


class MadeUpStop:
    """Its second link, which shows what it received."""

    written: ClassVar[list[str]] = []
    guarded: ClassVar[bool] = False

    def __init__(self, url: str, clock: Callable[[], int]) -> None:
        self.clock = clock
        self.written.append(f"open {url}")

    def reports(self) -> list[AxisReport]:
        return self.poll()

    def poll(self) -> list[AxisReport]:
        return []

    def abort(self) -> int:
        self.written.append("abort")
        return self.clock()

    def finish_stop(self, written_ns: int) -> StopTimes:
        self.written.append("disable")
        return StopTimes(written_ns, written_ns, self.clock())

    def trip(self) -> StopTimes:
        return self.finish_stop(self.abort())

    def close(self) -> None:
        self.written.append("close")


@dataclass
class MadeUpStage:
    """It goes at one speed and is received at once."""

    LINK: ClassVar[str] = "made up"
    ADDRESS: ClassVar[str] = "port:=7"
    state_type: ClassVar[type[MadeUpState]] = MadeUpState
    moves_across: ClassVar[bool] = False

    port: int
    limits: TravelLimits = field(default_factory=TravelLimits)
    lift_m: float = RAISED_M
    lift_speed_m_per_s: float = 0.020
    sweep_speed_m_per_s: float = 0.020

    def open(self, now_ns: int, state: MadeUpState, rng: np.random.Generator) -> None:
        state.open_count += 1

    def close(self) -> None:
        pass

    def health(self, now_ns: int) -> DeviceHealth:
        return HEALTHY

    def stop_link(
        self, url: str, *, timeout_s: float, look_hz: float, clock: Callable[[], int]
    ) -> MadeUpStop:
        return MadeUpStop(url, clock)

    def discover(self) -> dict[str, str]:
        return {"controller": f"answers on port {self.port}"}

    def acknowledge(self, now_ns: int, state: MadeUpState) -> None:
        pass

    def sweep_start(self, from_m: float, to_m: float) -> float:
        return from_m - 1e-3

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: MadeUpState) -> SweepTimes:
        end_ns = self._go(to_m + 1e-3, 0.0, now_ns, state)
        lead_ns = round(1e-3 / self.sweep_speed_m_per_s * 1e9)
        return SweepTimes(now_ns + lead_ns, end_ns - lead_ns, end_ns)

    def return_to(
        self,
        y_m: float,
        now_ns: int,
        state: MadeUpState,
        *,
        height_m: float = 0.0,
        across_m: float | None = None,
    ) -> int:
        self.limits.check_across(across_m or 0.0)
        return self._go(y_m, height_m, now_ns, state)

    def retreat(self, speed_m_per_s: float, now_ns: int, state: MadeUpState) -> int:
        return self._go(self._place_m(np.array([now_ns]), state)[0], self.lift_m, now_ns, state)

    def stop(self, now_ns: int, state: MadeUpState) -> int:
        return self._go(self._place_m(np.array([now_ns]), state)[0], state.z_m, now_ns, state)

    def feedback(self, now_ns: int, state: MadeUpState) -> StageFeedback:
        moving = now_ns < state.end_ns
        y_m = float(self._place_m(np.array([now_ns]), state)[0])
        speed_m_per_s = self.sweep_speed_m_per_s if moving else 0.0
        return StageFeedback(y_m, state.z_m, speed_m_per_s, moving, now_ns, now_ns)

    def read(self, times_ns: Int64Array, state: MadeUpState) -> StageReading:
        y_m = self._place_m(times_ns, state)
        return StageReading(y_m, np.full_like(y_m, state.z_m))

    def _go(self, to_m: float, z_m: float, now_ns: int, state: MadeUpState) -> int:
        state.from_m, state.to_m = float(self._place_m(np.array([now_ns]), state)[0]), float(to_m)
        way_s = abs(state.to_m - state.from_m) / self.sweep_speed_m_per_s
        state.start_ns, state.end_ns, state.z_m = now_ns, now_ns + round(way_s * 1e9) + 1, z_m
        return state.end_ns

    @staticmethod
    def _place_m(times_ns: Int64Array, state: MadeUpState) -> np.ndarray:
        return np.interp(times_ns, [state.start_ns, state.end_ns], [state.from_m, state.to_m])
