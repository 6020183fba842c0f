"""The one runner of every study: cases, the schemes that decide in each, and what came of their sessions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from palp_core.errors import PalpError
from palp_core.methods import find
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.rig_noise import RigNoise, assumed_noise
from palp_core.palpation.perception.belief.stopping import PaperVerbatim, PosteriorThreshold, StopRule
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    StiffnessPolicy,
    UniformRings,
)
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent, Reposition
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.studies.parallel import Runner, Seed
from palp_core.palpation.studies.plan import PAPER_PROTOCOL, SWIFT, Protocol
from palp_core.palpation.studies.session import Indices, WorldPlan, WorldSession, begin, feature_of
from palp_core.palpation.studies.training import TrainedFeature, best_ring, train_feature
from palp_core.palpation.studies.trials import (
    Outcomes,
    chance,
    draw_rings,
    model_of,
    run_trace_trials,
    run_trials,
    settings_of,
)

TRACE = "trace"
STIFF_M = (0.008, 0.012, 0.016)
ASSUMED = assumed_noise(0.3e-3 / 3**0.5, 0.2e-3)
"""Landing by the data sheet and height, of a lab's filter of features, as of that of the trace."""
SURE = 0.99
"""Threshold where the belief is looked at forty times a sweep."""


def fixed_name(ring_m: float) -> str:
    """Return the name of the policy that stays at a ring position, as ``fixed_16``."""
    return f"fixed_{ring_m * 1e3:g}"


FIXED = tuple(fixed_name(ring_m) for ring_m in figure5.RINGS_M)
"""The paper's fixed positions, whose mean is ``fixed_average``."""

POLICIES = (
    "chance",
    "best_single_probe",
    *FIXED,
    "fixed_best",
    "markov",
    "markov_stationary",
    "markov_reversed",
    "markov_permuted",
    "uniform",
    "uniform_stiff",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)
"""Policies by the names of ``paper.json``: all but ``fixed_average``, which is a mean of others."""


@dataclass(frozen=True)
class Scheme:
    """A way to decide."""

    name: str  # as in tables
    policy: str  # one of POLICIES; information_gain goes by the naive filter, unless by a trace
    reading: str = ""  # peak, contrast or trace; empty: that of the gel
    filter: str = "naive"  # task filter; a trace has a filter of its own
    stop: StopRule = field(default_factory=PaperVerbatim)  # the stop rule
    # the cycle of a palpation; None: whole sweeps over the plan's path, as the paper times them
    protocol: Protocol | None = None
    # what the latent filter assumes of the rig; None: the spreads that landing and height have
    noise: RigNoise | None = None
    # how the human strategy is read: reconstruction, reading, mixture
    chain: tuple[str, str, str] = ("ar1", "column", "average")
    grid_m: tuple[float, ...] = ()  # depths to decide among, where these are not the session's


def lab_scheme(reading: str, policy: str, rule: str, protocol: str = "paper") -> Scheme:
    """Return a way to decide in a lab, whose filters know nothing of the objects that make the readings."""
    name = ", ".join([reading, policy, rule] + [protocol] * (protocol != "paper"))
    plain, informed = rule == "paper", policy == "information_gain" and reading != TRACE
    return Scheme(
        name,
        "information_gain_latent" if informed and not plain else policy,
        reading,
        "naive" if plain else "latent",
        PaperVerbatim() if plain else PosteriorThreshold(SURE if reading == TRACE else 0.95),
        SWIFT if protocol == "swift" else PAPER_PROTOCOL,
        ASSUMED,
    )


@dataclass(frozen=True)
class Case:
    """Sessions alike, and the schemes that decide in each."""

    name: str  # as in tables
    plan: WorldPlan  # world, rig and experiment
    schemes: tuple[Scheme, ...]  # what decides; all meet the same trials


@dataclass(frozen=True, eq=False)
class SchemeRun:
    """What a scheme did in a session."""

    ended: Outcomes  # its trials
    cpu_s: float  # CPU seconds per trial of deciding all trials at once, without simulating the sweeps


SessionRuns = Sequence[dict[str, SchemeRun]]
"""What each scheme did, by name, a session each."""


def run(
    cases: Sequence[Case], sessions: int, runner: Runner, *, stream: int, label: str
) -> dict[str, SessionRuns]:
    """Return what came of every session of each case, by the case's name."""
    found = runner.run(run_session, cases, sessions, stream=stream, label=label)
    return {case.name: own for case, own in zip(cases, found, strict=True)}


def run_session(case: Case, seed: Seed) -> dict[str, SchemeRun]:
    """Return what each scheme of a case did in one session."""

    @cache
    def swept(protocol: Protocol | None) -> WorldSession:
        if protocol is None:
            return begin(case.plan, seed)
        conditions = replace(case.plan.conditions, rehome=protocol.rehome)
        return begin(replace(case.plan, path_m=protocol.path_m, conditions=conditions), seed)

    @cache
    def trained(
        reading: str, protocol: Protocol | None, noise: RigNoise | None, grid_m: tuple[float, ...]
    ) -> TrainedFeature:
        return train_feature(swept(protocol), reading, grid_m=grid_m, noise=noise)

    @cache
    def traced(protocol: Protocol, depths: int) -> TraceModel:
        session = swept(protocol)
        return model_of(session, settings_of(session, depths=depths))

    @cache
    def best_by_contrast() -> int:
        training, gel = swept(PAPER_PROTOCOL).training, case.plan.gel
        readings = feature_of("contrast", training.traces)
        return best_ring(readings.reshape(len(gel.depths_m), len(gel.rings_m), -1))

    @cache
    def stayed(ring_m: float, scheme: Scheme) -> SchemeRun:
        return _by_feature(known(scheme), scheme, FixedRing(ring_m))

    def known(scheme: Scheme) -> TrainedFeature:
        return trained(scheme.reading or case.plan.gel.reading, scheme.protocol, scheme.noise, scheme.grid_m)

    found: dict[str, SchemeRun] = {}
    for scheme in case.schemes:
        if scheme.reading == TRACE:
            protocol = scheme.protocol or PAPER_PROTOCOL
            model = traced(protocol, len(scheme.grid_m))
            found[scheme.name] = _by_trace(swept(protocol), scheme, protocol, model, best_by_contrast)
            continue
        policy = ring_policy(scheme, known(scheme))
        if isinstance(policy, FixedRing):  # the same ring meets the same trials, whatever the scheme's name
            found[scheme.name] = stayed(policy.ring_m, replace(scheme, name="", policy=""))
        else:
            found[scheme.name] = _by_feature(known(scheme), scheme, policy)
    return found


def _by_feature(known: TrainedFeature, scheme: Scheme, policy: StiffnessPolicy | None) -> SchemeRun:
    simulating = known.session.simulating
    before = simulating.outside()
    if policy is None:
        ended = chance(known)
    else:
        timing = scheme.protocol.timing if scheme.protocol else None
        ended = run_trials(known, filter_model(scheme.filter, known), policy, scheme.stop, timing=timing)
    return SchemeRun(ended, (simulating.outside() - before) / len(ended.depth))


def filter_model(name: str, known: TrainedFeature) -> OffsetModel:
    """Return the model of a method of task ``filter``; ``naive`` is fitted to the readings themselves."""
    if name == "naive":
        return known.naive
    made: OffsetModel = find("filter", name).target(known.latent)
    return made


def ring_policy(scheme: Scheme, known: TrainedFeature) -> StiffnessPolicy | None:
    """Return a scheme's policy after a session's training; None for ``chance``."""
    name, rings_m = scheme.policy, known.session.rings_m
    if name.removeprefix("fixed_").replace(".", "").isdigit():
        return FixedRing(round(float(name.removeprefix("fixed_")) * 1e-3, 9))
    if name.startswith("markov"):
        return _chain(scheme, known)
    informed = {"information_gain": known.naive, "information_gain_latent": known.latent}
    match name:
        case "chance":
            return None
        case "fixed_best" | "best_single_probe":
            return FixedRing(known.best_ring_m)
        case "reposition_best":
            return Reposition(known.best_ring_m)
        case "uniform":
            return UniformRings(rings_m)
        case "uniform_stiff":
            return UniformRings(STIFF_M)
        case "information_gain" | "information_gain_latent":
            return InformationGainLatent(informed[name], rings_m)
    raise PalpError(f"there is no policy '{name}'; there are {', '.join(POLICIES)}")


def _chain(scheme: Scheme, known: TrainedFeature) -> MarkovPolicy:
    kind, reading, mixture = scheme.chain
    matrices = figure5.matrices(kind)  # type: ignore[arg-type]
    matrix = matrices.mean(axis=0)
    match scheme.policy:
        case "markov":
            return MarkovPolicy(matrices, reading=reading, mixture=mixture)  # type: ignore[arg-type]
        case "markov_stationary":
            return MarkovPolicy(markov.independent(matrix)[None])
        case "markov_reversed":
            return MarkovPolicy(markov.time_reversed(matrix)[None])
        case "markov_permuted":
            return MarkovPolicy(markov.permuted(matrix, known.session.order)[None])
    raise PalpError(f"there is no policy '{scheme.policy}'; there are {', '.join(POLICIES)}")


def _by_trace(
    session: WorldSession, scheme: Scheme, protocol: Protocol, model: TraceModel, best: Callable[[], int]
) -> SchemeRun:
    rings: Indices | None
    match scheme.policy:
        case "fixed_best":
            rings = np.full(len(session.depth), best())
        case "stiffest":
            rings = np.full(len(session.depth), len(session.rings_m) - 1)
        case "uniform":
            rings = draw_rings(UniformRings(session.rings_m), session)
        case "markov":
            rings = draw_rings(MarkovPolicy(), session)
        case "information_gain":
            rings = None
        case _:
            raise PalpError(f"there is no policy '{scheme.policy}' by the trace")
    before = session.simulating.outside()
    ended = run_trace_trials(session, model, protocol, rings, scheme.stop, depths_m=scheme.grid_m)
    return SchemeRun(ended, (session.simulating.outside() - before) / len(ended.depth))
