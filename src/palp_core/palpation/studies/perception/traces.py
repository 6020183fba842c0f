"""Errors of task ``trace_filter``: decisions from the torque of one sweep, whole or read as it comes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palp_core.methods import names
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.perception.trace.belief import along, begin_sweep, start
from palp_core.palpation.session.method_choices import of_traces
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.palpation.studies.frontier.protocols import SWIFT
from palp_core.palpation.studies.frontier.trace_trials import coarse, model_of, nearest, settings_of
from palp_core.palpation.studies.frontier.world_session import WorldPlan, WorldSession, begin
from palp_core.palpation.studies.perception.case import Seen, in_words, session_quantities
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.reading_table import Gel
from palp_core.palpation.studies.toolkit.parallel import seeds
from palp_core.palpation.world.model import LAB, PAPER, WorldModel
from palp_core.units import Float64Array

TASK = "trace_filter"
SURE = 0.99
"""Belief at which a sweep that is read as it comes is decided."""
RIG = Conditions(mounting="each_trial", specimens="other", phantoms=3, trials=60)
"""Every trial is mounted anew, and none of its phantoms was trained on."""
SESSIONS = 6
"""Of a case."""
_SEED = 47


@dataclass(frozen=True)
class TraceCase:
    """Sessions alike.

    Attributes:
        gel: What is touched.
        world: Its spreads.
        conditions: The rig, and the spread of heights.
        told: Spreads as the filter is told them, where they are not its usual ones: parameters by name.
    """

    gel: Gel = field(default_factory=Gel)
    world: WorldModel = LAB
    conditions: Conditions = RIG
    told: Mapping[str, float] = field(default_factory=dict)

    def settings(self, session: WorldSession, name: str = "") -> TraceSettings:
        """Return how a filter reads a session."""
        told = {"ring_sd_mm": max(1e3 * self.conditions.ring_sd_m, 0.01), **self.told}
        return replace(settings_of(session), trace_filter=name, **told)  # type: ignore[arg-type]

    @property
    def words(self) -> str:
        """It, in words."""
        more = [
            f"told {name} {self.told[name]:g}"
            for name in ("depths", "slope_error", "texture_sd_n_mm")
            if name in self.told
        ]
        return ", ".join([self.world.name, in_words(self.gel, self.conditions), *more])


def spread_as_told(share: float, run_in: bool, gel: Gel | None = None) -> TraceCase:
    """Return sessions whose phantoms and mountings spread as widely as their filter is told, and no less.

    Args:
        share: Of the usual spreads that a filter is told: friction and modulus a tenth, heights 0.2 mm, the
            bead 1 mm along and beside the path, the ball 0.1 mm.
        run_in: Whether the sweep begins upright and the surface has a texture, as in the lab's world.
        gel: What is touched.
    """
    usual, half = TraceSettings(), 0.5**0.5
    place_m = share * usual.place_sd_mm * 1e-3 * half  # by phantom, and by mounting
    world = replace(
        LAB if run_in else PAPER,
        name=f"{'lab' if run_in else 'paper'}, all spreads {share:g} times",
        friction_mounting_sd=share * usual.friction_sd,
        modulus_specimen_sd=share * usual.modulus_sd,
        layer_modulus_sd=0.0,
        bead_along_specimen_sd_m=place_m,
        bead_along_mounting_sd_m=place_m,
        bead_beside_specimen_sd_m=place_m,
        bead_beside_mounting_sd_m=place_m,
    )
    told = {
        name: share * getattr(usual, name)
        for name in ("friction_sd", "modulus_sd", "place_sd_mm", "trace_height_sd_mm", "tip_sd_mm")
    }
    height_m = share * usual.trace_height_sd_mm * 1e-3
    return TraceCase(gel or Gel(), world, replace(RIG, height_sd_m=height_m), told)


TOUCHES = (
    Gel(modulus_pa=15e3, friction=0.45, indentation_m=0.003),
    Gel(modulus_pa=30e3, friction=0.25, indentation_m=0.0045),
    Gel(depths_m=(0.003, 0.006)),
    Gel(depths_m=(0.0015, 0.003, 0.006, 0.012)),
    Gel(depths_m=(0.004, 0.006, 0.009)),
)
"""Beside the published one."""


def cases(*, quick: bool = False) -> Iterator[TraceCase]:
    """Give the sessions that errors are measured on; quick: the published touch in both worlds."""
    yield from (TraceCase(world=world) for world in (LAB, PAPER))
    if quick:
        return
    for run_in in (True, False):
        usual = spread_as_told(1.0, run_in)
        rig = usual.conditions
        yield from (spread_as_told(share, run_in) for share in (0.1, 0.5, 1.0, 2.0))
        yield from (spread_as_told(1.0, run_in, touch) for touch in TOUCHES)
        yield from (replace(usual, conditions=replace(rig, training=count)) for count in (3, 6, 60))
        yield replace(usual, conditions=replace(rig, training=2, phantoms=1))
        yield replace(usual, conditions=replace(rig, repeatability_m=0.0))
        yield spread_as_told(1.0, run_in, Gel(noise_factor=5.0))
        yield replace(usual, told={**usual.told, "depths": 31})
        yield replace(usual, told={**usual.told, "slope_error": 0.3, "texture_sd_n_mm": 0.4})
    yield replace(usual, told={**usual.told, "slope_error": 0.0, "texture_sd_n_mm": 0.05})


@dataclass(frozen=True, eq=False)
class Read:
    """What a filter made of a session's trials, one sweep each.

    Attributes:
        right: Whether the class was right, of whole sweeps and of those read as they come, shape (2, n).
        stated: How sure it was, likewise.
    """

    right: NDArray[np.bool_]
    stated: Float64Array


def read(session: WorldSession, settings: TraceSettings) -> Read:
    """Return what a filter makes of one sweep a trial, at the stiffest ring."""
    count, ring = len(session.depth), len(session.rings_m) - 1
    model, every = model_of(session, settings), np.arange(count)
    felt = coarse(session.traces(every, np.full(count, ring), session.landings_m[:, 0], 0))
    _, posterior = along(model, begin_sweep(start(model, count), ring, landed=True), felt)
    posterior = _of_depths(posterior, session, settings)
    sure = posterior.max(axis=2) >= SURE
    halt = np.where(sure.any(axis=1), np.argmax(sure, axis=1), felt.shape[1] - 1)
    ends = np.stack([posterior[:, -1], posterior[every, halt]])
    return Read(ends.argmax(axis=2) == session.depth, ends.max(axis=2))


def _of_depths(posterior: Float64Array, session: WorldSession, settings: TraceSettings) -> Float64Array:
    """Return the probabilities of the session's depths, shape (n, bins, m): of a grid, of what is nearest."""
    depths_m = np.asarray(session.depths_m)
    near = nearest(classes_of(depths_m.tolist(), settings.depths), depths_m)
    return np.stack([posterior[..., near == m].sum(axis=-1) for m in range(len(depths_m))], axis=-1)


def sessions(case: TraceCase, count: int, seed: int = _SEED) -> list[WorldSession]:
    """Return sessions, each with a training and trials of its own."""
    plan = WorldPlan(case.world, case.conditions, case.gel, path_m=SWIFT.path_m)
    return [begin(plan, one) for one in seeds(seed, 1, count)]


def wrong(reads: Sequence[Read]) -> Float64Array:
    """Return the share of wrong decisions, whole and as it comes, by session, shape (s, 2)."""
    return np.array([1.0 - one.right.mean(axis=1) for one in reads])


def miscalibrated(reads: Sequence[Read]) -> float:
    """Return the expected calibration error, the larger of whole sweeps and those read as they come."""
    stated = np.clip(np.concatenate([one.stated for one in reads], axis=1), 0.0, 1.0)
    right = np.concatenate([one.right for one in reads], axis=1)
    return max(calibration(s, r.tolist()).expected_error for s, r in zip(stated, right, strict=True))


def by_filter(case: TraceCase, begun: Sequence[WorldSession]) -> dict[str, list[Read]]:
    """Return what each filter made of sessions."""
    return {name: [read(one, case.settings(one, name)) for one in begun] for name in names(TASK)}


def errors(reads: Mapping[str, Sequence[Read]]) -> dict[str, dict[str, float]]:
    """Return each filter's error by output: wrong decisions beyond the best filter's, and calibration."""
    shares = {name: wrong(own).mean(axis=0) for name, own in reads.items()}
    best = np.min(list(shares.values()), axis=0)
    return {
        name: {"decision": float((share - best).max()), "calibration": miscalibrated(reads[name])}
        for name, share in shares.items()
    }


def quantities(case: TraceCase) -> dict[str, Any]:
    """Return what a filter is chosen by."""
    settings = replace(TraceSettings(), **case.told)  # type: ignore[arg-type]
    grid = {"class_count": float(settings.depths)} if settings.depths else {}
    return session_quantities(case.gel, case.conditions) | of_traces(settings) | grid


def traces_seen(*, quick: bool = False) -> list[Seen]:
    """Return the errors of every filter by touch, spread, training and noise; quick: the published ones."""
    found = []
    for case in cases(quick=quick):
        reads = by_filter(case, sessions(case, 2 if quick else SESSIONS))
        for name, of in errors(reads).items():
            found += [
                Seen(TASK, name, output, error, quantities(case), case.words) for output, error in of.items()
            ]
    return found
