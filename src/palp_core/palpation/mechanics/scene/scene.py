"""A scene: phantom, probe, path and ring positions, and how right which of its outputs must be."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics.limits import require
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.units import Float64Array

OUTPUTS = ("peak", "contrast", "trace", "separation", "decision")
"""Largest torque; that minus its local base; the torque all along the sweep, over its peak; smallest gap
between the peaks of named depths; share of depth decisions that differ."""

STRAINS = ("small", "finite")
"""Laws that an output must be right against: linear elasticity, or neo-Hookean gel at any strain."""

PAPER_DEPTHS_M = (0.002, 0.004, 0.008)

RINGS_M = (0.0, 0.016)
"""Ends of the published ring's travel."""

_HALVINGS = 20  # of the angle at which the tip rests: to a millionth of it


@dataclass(frozen=True, kw_only=True)
class StagePath:
    """One straight sweep of the stage at constant height; stage position 0 is over the bead.

    Attributes:
        indentation_m: Nominal indentation of the upright probe; assumed.
        speed_m_s: Speed of the stage; published.
        from_m: Stage position at the start; assumed.
        to_m: Stage position at the end; smaller than ``from_m`` for a sweep towards -Y; assumed.

    Raises:
        OutOfRange: A value is not a number, the speed is not positive or the path has no length.
    """

    indentation_m: float = 0.004
    speed_m_s: float = 0.02
    from_m: float = -0.03
    to_m: float = 0.05

    def __post_init__(self) -> None:
        require("indentation_m", self.indentation_m, -1.0, 1.0, "give metres, as in 0.004")
        require("speed_m_s", self.speed_m_s, 1e-9, 10.0, "give a positive speed in m/s, as in 0.02")
        require("from_m", self.from_m, -10.0, 10.0, "give metres, as in -0.03")
        require("to_m", self.to_m, -10.0, 10.0, "give metres, as in 0.05")
        if self.from_m == self.to_m:
            raise OutOfRange("to_m", f"the path starts and ends at {self.to_m:g}; give it a length")

    @property
    def margin_m(self) -> float:
        """How far the path goes past the bead where it goes less far; negative if not across it."""
        return min(-min(self.from_m, self.to_m), max(self.from_m, self.to_m))

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return abs(self.to_m - self.from_m) / self.speed_m_s

    def stage_m(self, sample_hz: float = 1000.0) -> Float64Array:
        """Return the stage positions at a sampling rate, from the start to the last sample on the path."""
        require("sample_hz", sample_hz, 1e-3, 1e6, "give a positive rate in Hz, as in 1000")
        count = math.floor(self.duration_s * sample_hz * (1.0 + 1e-12)) + 1
        step_m = math.copysign(self.speed_m_s / sample_hz, self.to_m - self.from_m)
        positions: Float64Array = self.from_m + step_m * np.arange(count, dtype=np.float64)
        return positions


def motion_output(output: str) -> str:
    """Return what the joint's motion must get right where a scene is asked for ``output``.

    Depths are separated by their peaks. Its bounds are on peak and contrast; a trace takes the stricter.
    """
    return "contrast" if output in ("contrast", "trace") else "peak"


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """How accurate an output must be.

    Attributes:
        output: One of :data:`OUTPUTS`.
        relative: Largest relative error; of ``decision`` the share of decisions that may differ.
        depths_m: Depths compared, for ``separation`` and ``decision``; the paper's three if empty.
        strain: The law to compare with, one of :data:`STRAINS`.

    Raises:
        OutOfRange: An unknown output or law, a tolerance that is not positive, or fewer than two different
            depths.
    """

    output: str = "peak"
    relative: float = 0.02
    depths_m: tuple[float, ...] = ()
    strain: str = "small"

    def __post_init__(self) -> None:
        if self.output not in OUTPUTS:
            raise OutOfRange("output", f"must be one of {', '.join(OUTPUTS)}, not '{self.output}'")
        if self.strain not in STRAINS:
            raise OutOfRange("strain", f"must be one of {', '.join(STRAINS)}, not '{self.strain}'")
        require("relative", self.relative, 1e-9, 1e3, "give a positive share, as in 0.05")
        for depth_m in self.depths_m:
            require("depths_m", depth_m, 1e-6, 1.0, "give metres of gel over the bead, as in 0.004")
        if self.depths_m and len(set(self.depths_m)) < max(2, len(self.depths_m)):
            raise OutOfRange("depths_m", "give two or more depths, each once")

    @property
    def bound_on(self) -> str:
        """What the contact rungs' bounds are asked for: ``contrast``, or ``finite_contrast``."""
        return self.output if self.strain == "small" else f"{self.strain}_{self.output}"

    @property
    def compared_m(self) -> tuple[float, ...]:
        """Depths that the output compares; none for ``peak``, ``contrast`` and ``trace``."""
        return (self.depths_m or PAPER_DEPTHS_M) if self.output in ("separation", "decision") else ()


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A probe, a phantom, the path of the sweep, and how accurate the result must be.

    >>> from palp_core.palpation import Bead, Phantom, Scene, choose_rung
    >>> scene = Scene(phantom=Phantom(bead=Bead(depth_m=0.002)), ring_m=(0.008,))
    >>> choose_rung(scene).rung
    'l2'

    Attributes:
        phantom: The gel that is touched, and the bead in it.
        probe: The probe that touches it.
        path: The path of the stage.
        ring_m: Ring positions r_a; the probe sweeps once at each.
        tolerance: The output that matters, and its largest error.
        budget_s: Seconds of CPU that set-up and sweeps may take; None for no limit.

    Raises:
        OutOfRange: No ring position, one that is no number or leaves the joint unstable, or a budget that is
            not positive.
    """

    phantom: Phantom = field(default_factory=lambda: Phantom(bead=Bead(depth_m=0.004)))
    probe: Probe = field(default_factory=Probe)
    path: StagePath = field(default_factory=StagePath)
    ring_m: tuple[float, ...] = (0.004, 0.016)
    tolerance: Tolerance = field(default_factory=Tolerance)
    budget_s: float | None = None

    def __post_init__(self) -> None:
        if not self.ring_m:
            raise OutOfRange("ring_m", "give at least one ring position in metres, as in [0.008]")
        for ring_m in self.ring_m:
            require("ring_m", ring_m, -1.0, 1.0, "give the ring's position in metres, as in 0.008")
            self.probe.require_held(ring_m)
        try:
            _ = self.phantoms
        except OutOfRange as error:
            raise OutOfRange("tolerance", f"its depths_m do not fit the phantom: {error}") from error
        if self.budget_s is not None:
            require(
                "budget_s", self.budget_s, 1e-6, 1e9, "give the seconds that it may take, or leave it out"
            )

    @property
    def phantoms(self) -> tuple[Phantom, ...]:
        """What the output needs: the phantom, or it at each of the depths to compare."""
        depths_m = self.tolerance.compared_m
        if not depths_m:
            return (self.phantom,)
        bead = self.phantom.bead or Bead(depth_m=depths_m[0])
        return tuple(replace(self.phantom, bead=replace(bead, depth_m=d)) for d in depths_m)

    def read_by(self, output: str) -> Scene:
        """Return the scene of a run that reads its sweeps by ``output``: within the same tolerance.

        Separations of depths and decisions are read off peaks: a scene asked for these stays for a peak.

        Args:
            output: ``peak``, ``contrast`` or ``trace``; anything else a run may read follows from the trace.
        """
        asked = self.tolerance
        if output == "peak" and asked.compared_m:
            return self
        read = output if output in ("peak", "contrast") else "trace"
        return replace(self, tolerance=replace(asked, output=read))

    def with_bead(self, depth_m: float) -> Scene:
        """Return the scene with its bead, or the published one, at a depth; at 0 it is bare gel."""
        bead = replace(self.phantom.bead or Bead(depth_m=depth_m), depth_m=depth_m) if depth_m > 0.0 else None
        return replace(self, phantom=replace(self.phantom, bead=bead))

    def quantities(self) -> dict[str, float | tuple[float, ...]]:
        """Return the quantities by which methods are chosen, SI; several values where there are several."""
        found: dict[str, float | tuple[float, ...]] = dict(self.phantoms[0].scene(self.probe.tip_radius_m))
        if len(self.phantoms) > 1:
            found["depth_m"] = self.tolerance.compared_m
            found["depth_per_tip"] = tuple(d / self.probe.tip_radius_m for d in self.tolerance.compared_m)
            found["depth_ratio"] = min(
                b / a for a, b in itertools.pairwise(sorted(self.tolerance.compared_m))
            )
        return found | {
            "friction": self.probe.friction,
            "tip_mass_kg": self.probe.tip_mass_kg,
            "margin_m": self.path.margin_m,
            **pressed(self.phantoms, self.probe, self.path.indentation_m, self.ring_m),
        }


def pressed(
    phantoms: Sequence[Phantom], probe: Probe, indentation_m: float, ring_m: tuple[float, ...]
) -> dict[str, float | tuple[float, ...]]:
    """Return the quantities of pressing by which methods are chosen, SI: how deep, and what that does."""
    return {
        "indentation_m": indentation_m,
        "ring_m": ring_m,
        "yielding": tuple(yielding(phantoms[0], probe, indentation_m, r) for r in ring_m),
        "pressed_share": tuple(pressed_share(p, probe, indentation_m, r) for p in phantoms for r in ring_m),
    }


def yielding(phantom: Phantom, probe: Probe, indentation_m: float, ring_m: float) -> float:
    """Return how far the joint gives way: the moment of the gel's force over what the joint can hold.

    The force is Hertz's at the nominal indentation, its lever the probe's. Well above 1 the joint gives way
    until the gel lets it, and the peak hardly depends on the force; well below 1 it is as wrong as that.
    """
    pressed_m = max(indentation_m, 0.0)
    force_n = 4.0 / 3.0 * phantom.modulus_pa * math.sqrt(probe.tip_radius_m * pressed_m) * pressed_m
    held_n_m = probe.spring_n_m(ring_m) + probe.weight_n_m
    if held_n_m <= 0.0:
        return math.inf
    return force_n / (1.0 - phantom.poisson**2) * probe.lever_m / held_n_m


def pressed_share(phantom: Phantom, probe: Probe, indentation_m: float, ring_m: float) -> float:
    """Return how deep the tip comes, over the ball's radius or the gel over the bead, whichever is less.

    It comes deepest beside the bead, where the joint gives way least. Hertz's law for a sphere on a
    half-space, softer than any slab, says where the lagging tip rests: a little deeper than it will.
    """
    lever_m, radius_m = probe.lever_m, probe.tip_radius_m
    nominal_m = min(max(indentation_m, 0.0), 0.999 * lever_m)
    held_n_m = probe.spring_n_m(ring_m) + probe.weight_n_m
    hertz = 4.0 / 3.0 * phantom.modulus_pa * math.sqrt(radius_m) / (1.0 - phantom.poisson**2)
    low, high = 0.0, math.acos(1.0 - nominal_m / lever_m)
    for _ in range(_HALVINGS):
        angle = 0.5 * (low + high)
        sine, cosine = math.sin(angle), math.cos(angle)
        pressed_m = max(nominal_m - lever_m * (1.0 - cosine), 0.0)
        normal_n = hertz * pressed_m**1.5 * max(1.0 - 0.1 * pressed_m / radius_m, 0.0)
        pushing = probe.friction * normal_n * (lever_m * cosine + radius_m) + lever_m * normal_n * sine
        low, high = (angle, high) if held_n_m * sine < pushing else (low, angle)
    deepest_m = nominal_m - lever_m * (1.0 - math.cos(low))
    return deepest_m / min(radius_m, math.inf if phantom.bead is None else phantom.bead.depth_m)
