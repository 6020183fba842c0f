"""Time and error of one contact rung at one resolution."""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.graph.clock import monotonic_ns
from palp_core.methods import find, methods
from palp_core.palpation.mechanics import ContactModel, Phantom, Probe, Sweep, sweep
from palp_core.palpation.mechanics.scene.output import contrast_n_m, peak_n_m
from palp_core.units import Float64Array

SWEEP_POSITIONS = 3000
_OFFSETS_M = np.linspace(0.0, 0.012, 7)
_INDENTATIONS_M = np.array([0.001, 0.002, 0.003, 0.004])
_NOMINAL_M = 0.004
_LONG_S = 0.5


@dataclass(frozen=True)
class RungVariant:
    """A rung at a resolution.

    Attributes:
        rung: Its name in the register.
        resolution: In words; empty where there is nothing to set.
        arguments: What its constructor takes beyond phantom and ball.
        usual: Whether this is what is chosen when the rung is.
    """

    rung: str
    resolution: str = ""
    arguments: tuple[tuple[str, Any], ...] = ()
    usual: bool = True

    @property
    def label(self) -> str:
        """Rung and resolution."""
        return f"{self.rung.upper()} {self.resolution}".strip()

    def model(self, phantom: Phantom, probe: Probe) -> ContactModel:
        """Return the contact model, set up by its first force."""
        target, arguments = find("contact", self.rung).target, dict(self.arguments)
        made: ContactModel = target(phantom, probe.tip_radius_m, tip=probe.tip, **arguments)
        return made


@dataclass(frozen=True, eq=False)
class RungCost:
    """What one variant takes and gives over one phantom.

    Attributes:
        variant: Rung and resolution.
        depth_m: Depth of the bead.
        setup_s: Seconds until the first force, nothing cached.
        sweep_s: Seconds for a sweep of 3000 positions at the last ring it can sweep, median of repeats; NaN
            if it can at none.
        normal_n: Forces over a grid of offsets and of those indentations that the rung reaches.
        peak_n_m: By ring, of those it can sweep.
        contrast_n_m: Likewise.
        errors: Relative errors by output and ring, against the reference; empty for the reference.
    """

    variant: RungVariant
    depth_m: float
    setup_s: float
    sweep_s: float
    normal_n: Float64Array
    peak_n_m: dict[float, float]
    contrast_n_m: dict[float, float]
    errors: dict[tuple[str, float | None], float] = field(default_factory=dict)

    def error(self, output: str, ring_m: float | None) -> float:
        """Return the relative error of an output; NaN where the rung has no such output."""
        return self.errors.get((output, ring_m), float("nan"))


def variants(*, quick: bool) -> list[RungVariant]:
    """Return the rungs and resolutions to measure; the last is the reference."""
    declared = {one.name for one in methods("contact")}

    def sizes(rung: str, name: str, lengths_m: Sequence[float], usual_m: float) -> list[RungVariant]:
        return [
            RungVariant(rung, f"{length_m * 1e3:g} mm", ((name, length_m),), usual=length_m == usual_m)
            for length_m in lengths_m
        ]

    found = [
        *(RungVariant(name) for name in ("l0", "l1", "l2")),
        *sizes("l3", "facet_m", (0.002,) if quick else (0.002, 0.001), 0.001),
        *sizes("l5", "facet_m", (0.000375,) if quick else (0.00075, 0.000375), 0.000375),
        *sizes("l4", "cell_m", (0.001, 0.0005) if quick else (0.002, 0.001, 0.0005), 0.001),
    ]
    return [one for one in found if one.rung in declared]


@contextlib.contextmanager
def cold_cache() -> Iterator[None]:
    """Let set-ups find nothing on disk, and leave nothing behind."""
    before = os.environ.get("PALP_CACHE")
    with tempfile.TemporaryDirectory(prefix="palp-cold-") as folder:
        os.environ["PALP_CACHE"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["PALP_CACHE"]
            else:
                os.environ["PALP_CACHE"] = before


def median_s(action: Callable[[], object], repeats: int = 7) -> float:
    """Return the median time of an action, in s, after one unmeasured run; once only if that takes long."""
    times = []
    for i in range(repeats + 1):
        start_ns = monotonic_ns()
        action()
        taken_s = (monotonic_ns() - start_ns) / 1e9
        if i == 0 and taken_s > _LONG_S:
            return taken_s
        times.append(taken_s)
    return float(np.median(times[1:]))


def side_by_side(actions: Mapping[str, Callable[[], object]], repeats: int = 7) -> dict[str, list[float]]:
    """Return the times of each action, in s, taken in turns so that a busy machine slows all alike."""
    times: dict[str, list[float]] = {name: [] for name in actions}
    for action in actions.values():
        action()
    for _ in range(repeats):
        for name, action in actions.items():
            start_ns = monotonic_ns()
            action()
            times[name].append((monotonic_ns() - start_ns) / 1e9)
    return times


def measure(
    variant: RungVariant,
    phantom: Phantom,
    probe: Probe,
    rings_m: Sequence[float],
    against: RungCost | None = None,
) -> RungCost:
    """Time a variant and compare what it gives.

    Args:
        variant: Rung and resolution.
        phantom: What is touched.
        probe: With what.
        rings_m: Ring positions.
        against: The reference.

    Raises:
        MechanicsError: The rung cannot be set up for this phantom and ball.
    """
    stage = np.linspace(-0.03, 0.05, SWEEP_POSITIONS)
    with cold_cache():
        start_ns = monotonic_ns()
        model = variant.model(phantom, probe)
        depths_m = _INDENTATIONS_M[model.indentation_max_m >= _INDENTATIONS_M]  # what it reaches
        normal_n, _ = model.force(_OFFSETS_M[:, None], depths_m)
        setup_s = (monotonic_ns() - start_ns) / 1e9
    depth_m = phantom.bead.depth_m if phantom.bead is not None else 0.0
    errors: dict[tuple[str, float | None], float] = {}
    if against is not None:
        errors["normal", None] = _off(normal_n, against.normal_n[:, : len(depths_m)])
    solved: dict[float, Sweep] = {}
    sweep_s = float("nan")
    for ring_m in rings_m:
        with contextlib.suppress(MechanicsError):  # the tip is deeper than the rung reaches
            solved[ring_m] = sweep(model, probe, ring_m, _NOMINAL_M, stage)
    if solved:
        last_m = max(solved)
        sweep_s = median_s(lambda: sweep(model, probe, last_m, _NOMINAL_M, stage))
    peaks = {ring_m: peak_n_m(one) for ring_m, one in solved.items()}
    contrasts = {ring_m: contrast_n_m(one) for ring_m, one in solved.items()}
    if against is not None:
        for ring_m in solved:
            errors["peak", ring_m] = abs(peaks[ring_m] / against.peak_n_m[ring_m] - 1.0)
            errors["contrast", ring_m] = abs(contrasts[ring_m] / against.contrast_n_m[ring_m] - 1.0)
    return RungCost(variant, depth_m, setup_s, sweep_s, normal_n, peaks, contrasts, errors)


def _off(given: Float64Array, true: Float64Array) -> float:
    """Return the largest relative difference."""
    return float(np.max(np.abs(given / true - 1.0)))
