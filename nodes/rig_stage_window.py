"""Where the real stage may go: its node's parameters, and which are refused before anything starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nodes.named_files import file_mistakes
from nodes.safety_limits import DeadlineMilliseconds
from nodes.stage import StageParams
from palp_core import ReadOnly
from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import TravelLimits, check_lift
from palp_core.palpation.devices.registry import device_mistakes
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Path
from palp_core.units import (
    HertzPositive,
    Metres,
    MetresPerSecondPositive,
    MillimetresNonNegative,
    MillimetresPositive,
)


class RigStageParams(StageParams):
    """Set in the launch file.

    The travel window is the sweep's path, the place of rest, and ``margin_mm``. ``beat_ms`` is how long the
    stage goes on without a word of the safety node; after a trip it is raised at ``retreat_speed_m_s``,
    as nobody knows how the probe lies. ``scene`` is the scene file that says how deep the probe enters the
    gel (empty: the default scene): ``lift_mm`` must clear it.
    """

    device: ReadOnly[str] = "aerotech"
    options: ReadOnly[dict[str, Any]] = {}
    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    margin_mm: ReadOnly[MillimetresNonNegative] = 4.0
    scene: ReadOnly[str] = ""
    lift_mm: ReadOnly[MillimetresPositive] = 20.0
    speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.050
    lift_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.020
    retreat_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.002
    watch_hz: HertzPositive = 100.0
    beat_ms: ReadOnly[DeadlineMilliseconds] = 50.0


def driver_options(p: RigStageParams) -> dict[str, Any]:
    """Return the options of the driver, those of ``options`` last.

    Raises:
        DeviceError: The window or a speed is none.
    """
    limits = TravelLimits.around(p.from_m, p.to_m, p.margin_mm * 1e-3, p.lift_mm * 1e-3, p.speed_m_s)
    own = {"limits": limits, "lift_m": p.lift_mm * 1e-3, "lift_speed_m_per_s": p.lift_speed_m_s}
    return {**own, "sweep_speed_m_per_s": p.sweep_speed_m_s, **p.options}


def require_clearance(p: RigStageParams) -> None:
    """Refuse a lift at which the raised probe would be dragged through the scene's gel.

    Raises:
        DeviceError: It is one.
        MechanicsError: The scene cannot be read.
    """
    path = read_scene(p.scene).path if p.scene else Path()
    lift_m = p.options.get("lift_m", p.lift_mm * 1e-3)
    if isinstance(lift_m, int | float):  # what is no number the driver refuses
        check_lift(lift_m, path.indentation_m)


def mistakes(params: RigStageParams) -> dict[str, str]:
    """Return what is wrong with the parameters, by parameter; "" for what concerns several."""
    if found := file_mistakes(params):
        return found
    checks: tuple[tuple[str, Callable[[], object]], ...] = (
        ("options" if "lift_m" in params.options else "lift_mm", lambda: require_clearance(params)),
        ("", lambda: driver_options(params)),
    )
    for name, check in checks:
        try:
            check()
        except DeviceError as error:
            found[name] = str(error)
    return found or device_mistakes("stage", params.device, driver_options(params))
