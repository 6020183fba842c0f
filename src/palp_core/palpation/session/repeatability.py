"""What the plan ``repeatability`` has shown: variance components, the noise file, and a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import pywt
from scipy.stats import t as student_t

from palp_core.counted import counted
from palp_core.errors import PalpError, PerceptionError
from palp_core.palpation.mechanics.phantom import Bead
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.rig_noise import Component, RigNoise, write_noise
from palp_core.palpation.perception.statistics.statistics import Interval
from palp_core.palpation.perception.statistics.variance_components import Block, estimate
from palp_core.palpation.reporting.html_page import write_page
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.session.plan_repeatability import CONDITIONS
from palp_core.palpation.session.reanalysis import Methods, readings
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps
from palp_core.units import Float64Array

_GAUSSIAN_MAD = 0.6744897501960817


@dataclass(frozen=True, eq=False)
class Repeatability:
    noise: RigNoise  # the components, as simulation and filter load them
    ring_slope: dict[float, float]  # change of the reading per metre of the ring, N m/m, by ring
    height_slope: float  # the same per metre of height, at the ring of the mountings
    sweep_count: int


def measure_repeatability(session: RecordedSweeps, *, scene: Scene | None = None) -> Repeatability:
    """Return the components of a session that followed the plan.

    How a reading answers to the ring comes from the session's own means over the rings; how it answers to the
    height from the mechanics of the scene, for no session moves the height by a known amount.
    """
    sweeps = [sweep for sweep in session.sweeps if sweep.phase in CONDITIONS]
    if not sweeps:
        raise PalpError(f"{session.path}: did not follow the plan; run palp launch FILE plan:=repeatability")
    values = readings(sweeps, Methods())
    groups = _groups(sweeps, values)
    moved = {ring: found for (phase, ring), found in groups.items() if phase == "reposition"}
    if len(moved) < 2:
        raise PalpError(f"{session.path}: ended before the ring was re-positioned at two positions")
    rings = sorted(moved)
    means = [float(np.mean(np.concatenate(moved[ring]))) for ring in rings]
    slopes = dict(zip(rings, np.gradient(means, rings).tolist(), strict=True))
    used = scene or Scene()
    depth_m = sweeps[0].depth_m
    if depth_m is None:
        depth_m = (used.phantom.bead or Bead(depth_m=0.004)).depth_m
    height = {
        ring: float(height_slope((depth_m,), (ring,), "peak", used)[0, 0])
        for phase, ring in groups
        if phase == "remount"
    }
    blocks = [
        Block(*_cause(phase, ring, slopes, height), tuple(found)) for (phase, ring), found in groups.items()
    ]
    try:
        found = estimate(blocks)
    except PerceptionError as error:
        raise PalpError(f"{session.path}: {error}; let the plan run to its end") from error
    noise = RigNoise(
        sample_sd_n_m=sample_noise(sweeps),
        sweep_sd_n_m=_component(found[""]),
        ring_sd_m=_component(found["ring"]),
        height_sd_m=_component(found["height"]) if "height" in found else Component(0.0),
        hour_sd_n_m=_component(found["hour"], 2.0**0.5) if "hour" in found else Component(0.0),
        basis=(
            f"plan repeatability: {counted(len(sweeps), 'sweep')} over phantom {sweeps[0].phantom}; "
            f"height by the mechanics of a gel of {used.phantom.modulus_pa / 1e3:g} kPa at "
            f"{used.path.indentation_m * 1e3:g} mm"
        ),
    )
    return Repeatability(noise, slopes, next(iter(height.values()), 0.0), len(sweeps))


def _groups(
    sweeps: Sequence[RecordedSweep], values: Float64Array
) -> dict[tuple[str, float], list[Float64Array]]:
    """Return readings by condition and ring, a group per trial."""
    found: dict[tuple[str, float], list[Float64Array]] = {}
    pairs = list(zip(sweeps, values.tolist(), strict=True))
    for _, group in groupby(pairs, key=lambda pair: (pair[0].phase, pair[0].trial)):
        members = list(group)
        first = members[0][0]
        found.setdefault((first.phase, first.ring_m), []).append(np.array([v for _, v in members]))
    return found


def _cause(
    phase: str, ring: float, slopes: dict[float, float], height: dict[float, float]
) -> tuple[str, float]:
    if phase == "reposition":
        return "ring", slopes[ring]
    if phase == "remount":
        return "height", height[ring]
    return ("hour", 1.0) if phase == "hour" else ("", 0.0)


def _component(found: Interval, factor: float = 1.0) -> Component:
    high = factor * found.high
    return Component(factor * found.value, factor * found.low, high if np.isfinite(high) else None)


def sample_noise(sweeps: Sequence[RecordedSweep]) -> Component:
    """Return a sample's noise: the median of the finest detail, less rounding; t interval over sweeps."""
    each = np.array(
        [
            float(np.median(np.abs(pywt.dwt(np.array(s.torque_n_m), "db10")[1]))) / _GAUSSIAN_MAD
            for s in sweeps
        ]
    )
    reach = float(student_t.ppf(0.975, max(each.size - 1, 1)) * each.std(ddof=1) / np.sqrt(each.size))
    rounding = RESOLUTION_N_M**2 / 12.0
    value, low, high = (
        float(np.sqrt(max(sd, 0.0) ** 2 - rounding)) if sd > np.sqrt(rounding) else 0.0
        for sd in (each.mean(), each.mean() - reach, each.mean() + reach)
    )
    return Component(value, low, high)


def write_repeatability(found: Repeatability, out: Path, unfinished: str = "") -> None:
    """Write noise.yaml and report.html."""
    out.mkdir(parents=True, exist_ok=True)
    write_noise(found.noise, out / "noise.yaml")
    write_page(
        out / "report.html",
        "repeatability.html",
        sweep_count=found.sweep_count,
        unfinished=unfinished,
        noise=found.noise,
        strongest_ring_slope=max(abs(slope) for slope in found.ring_slope.values()),
        height_slope=found.height_slope,
    )


def repeatability_headline(found: Repeatability) -> str:
    noise = found.noise
    return (
        f"Repeatability (sd): ring {1e3 * noise.ring_sd_m.value:.3f} mm, height "
        f"{1e3 * noise.height_sd_m.value:.3f} mm, a sweep {1e3 * noise.sweep_sd_n_m.value:.4f} N mm, "
        f"an hour {1e3 * noise.hour_sd_n_m.value:.4f} N mm."
    )
