"""What the safety node is set to watch, and which settings are refused before anything starts."""

from __future__ import annotations

from typing import Annotated

import msgspec

from palp_core import Params, ReadOnly
from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import TravelLimits, WrenchLimits
from palp_core.palpation.devices.safety.watchdog import WatchLimits
from palp_core.palpation.nano17 import RANGE_N, RANGE_N_M
from palp_core.units import (
    CountPositive,
    HertzPositive,
    Metres,
    MetresPerSecondPositive,
    MillimetresNonNegative,
    MillimetresPositive,
    MillisecondsPositive,
    NewtonMillimetresPositive,
    NewtonsPositive,
)

DeadlineMilliseconds = Annotated[float, msgspec.Meta(ge=1.0, le=10_000.0, extra_json_schema={"x-unit": "ms"})]
"""A longest time without a word: under a millisecond nothing is heard, over 10 s nothing is guarded."""

ONE_LINK = (
    "one link only (stop_url is empty): a stop reaches the stage through its node alone, and homing is "
    "stopped by nothing but the emergency stop: keep a hand on it; give the stage segment_m: 0.002 and "
    "home_on_open: false"
)


class SafetyParams(Params):
    """Set in the launch file. The limits are assumed.

    ``range_n_mm`` and ``range_n`` are the largest torque and force that the sensor can tell (the maker's
    figures for SI-12-0.12); a stop above them could never trip and is refused.

    ``stop_url`` is the controller's second TCP port; empty: the trip reaches the stage through its node only.
    ``link_ms`` is the longest wait for an answer there: 2 mm at the speed of a sweep.
    ``watch_processes`` trips when a process of the graph is stopped by a signal, or ends in a sweep.
    """

    stop_url: ReadOnly[str] = ""
    axes: ReadOnly[tuple[str, str]] = ("X", "Y")
    baud: ReadOnly[CountPositive] = 115200
    tick_hz: ReadOnly[HertzPositive] = 100.0
    look_hz: ReadOnly[HertzPositive] = 20.0
    link_ms: ReadOnly[MillisecondsPositive] = 100.0
    warn_n_mm: ReadOnly[NewtonMillimetresPositive] = 80.0
    stop_n_mm: ReadOnly[NewtonMillimetresPositive] = 100.0
    warn_n: ReadOnly[NewtonsPositive] = 8.0
    stop_n: ReadOnly[NewtonsPositive] = 10.0
    range_n_mm: ReadOnly[NewtonMillimetresPositive] = RANGE_N_M * 1e3
    range_n: ReadOnly[NewtonsPositive] = RANGE_N
    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    margin_mm: ReadOnly[MillimetresNonNegative] = 4.0
    lift_mm: ReadOnly[MillimetresPositive] = 20.0
    speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.050
    following_mm: ReadOnly[MillimetresPositive] = 0.5
    stale_ms: ReadOnly[DeadlineMilliseconds] = 25.0
    beat_ms: ReadOnly[DeadlineMilliseconds] = 50.0
    watch_processes: ReadOnly[bool] = True


def limits_of(p: SafetyParams) -> WatchLimits:
    """Return the limits of the watchdog.

    Raises:
        DeviceError: They contradict each other, or the sensor's range.
    """
    return WatchLimits(
        wrench=WrenchLimits(
            p.warn_n_mm * 1e-3, p.stop_n_mm * 1e-3, p.warn_n, p.stop_n, p.range_n_mm * 1e-3, p.range_n
        ),
        travel=TravelLimits.around(p.from_m, p.to_m, p.margin_mm * 1e-3, p.lift_mm * 1e-3, p.speed_m_s),
        following_m=p.following_mm * 1e-3,
        stale_s=p.stale_ms * 1e-3,
        beat_s=p.beat_ms * 1e-3,
    )


def mistakes(params: SafetyParams) -> dict[str, str]:
    """Return what is wrong with the limits, by parameter; "" for what concerns several."""
    try:
        limits_of(params)
    except DeviceError as error:
        guilty = {
            "stop_n_mm": params.stop_n_mm > params.range_n_mm,
            "warn_n_mm": params.warn_n_mm > params.stop_n_mm,
            "stop_n": params.stop_n > params.range_n,
            "warn_n": params.warn_n > params.stop_n,
        }
        return {next((name for name, wrong in guilty.items() if wrong), ""): str(error)}
    return {}
