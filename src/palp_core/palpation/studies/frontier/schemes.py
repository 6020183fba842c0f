"""The ways to decide that are compared: what is read, who chooses the ring, which filter, when to stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.methods import find
from palp_core.palpation.perception.belief.rig_noise import assumed_noise
from palp_core.palpation.perception.belief.session_check import (
    LOOK_P,
    Projected,
    SessionTrials,
    Shifted,
    shifted,
)
from palp_core.palpation.perception.belief.stopping import (
    FixedNumber,
    PaperVerbatim,
    PosteriorThreshold,
    StopRule,
)
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    StiffnessPolicy,
    UniformRings,
)
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.training import TrainedTraces
from palp_core.palpation.session.unlike_training import by_readings
from palp_core.palpation.studies.frontier.protocols import (
    PAPER_PROTOCOL,
    SWIFT,
    Protocol,
    sessions_by_protocol,
)
from palp_core.palpation.studies.frontier.trace_trials import (
    KeepRing,
    MostInformation,
    RingSelector,
    draw_rings,
    learnt_of,
    model_of,
    run_trace_trials,
    settings_of,
)
from palp_core.palpation.studies.simulation.policies import TrainedFeature, train_feature
from palp_core.palpation.studies.simulation.session import WorldPlan, WorldSession
from palp_core.palpation.studies.simulation.trials import Outcomes, run_trials

TRACE = "trace"
RING_SD_M = 0.3e-3 / 3**0.5
ASSUMED = assumed_noise(RING_SD_M, 0.2e-3)
"""Landing by the data sheet and height, of the filter of features, as of that of the trace."""
THRESHOLD = 0.95
SURE = 0.99
"""Threshold where the belief is looked at forty times a sweep."""


@dataclass(frozen=True)
class Scheme:
    """A way to decide.

    Attributes:
        reading: ``peak``, ``contrast`` or ``trace``.
        policy: ``fixed_best``, ``uniform``, ``markov`` or ``information_gain``.
        rule: ``paper``: the published filter and stop rule (of the trace the stop rule alone: a filter that
            takes its bins for independent is not one); ``threshold``: the filter that knows what stays,
            and a threshold on the posterior.
        protocol: ``paper`` or ``swift``.
        trace_filter: Method of task ``trace_filter``, of the trace.
    """

    reading: str
    policy: str
    rule: str
    protocol: str = "paper"
    trace_filter: str = "second_order"

    @property
    def name(self) -> str:
        """As in tables: ``trace, fixed_best, threshold, swift``."""
        words = [self.reading, self.policy, self.rule]
        words += [self.protocol] * (self.protocol != "paper")
        words += [self.trace_filter] * (self.trace_filter != "second_order")
        return ", ".join(words)

    @property
    def steps(self) -> Protocol:
        """What the rig does."""
        return SWIFT if self.protocol == "swift" else PAPER_PROTOCOL


POLICIES = ("fixed_best", "uniform", "markov", "information_gain")
SCHEMES = (
    *(Scheme(r, p, rule) for r in ("peak", "contrast") for rule in ("paper", "threshold") for p in POLICIES),
    *(Scheme("contrast", p, "threshold", "swift") for p in ("fixed_best", "information_gain")),
    *(Scheme(TRACE, p, rule) for rule in ("paper", "threshold") for p in POLICIES),
    *(Scheme(TRACE, p, "threshold", "swift") for p in POLICIES),
)


@dataclass(frozen=True)
class DepthTask:
    """A depth to be told in millimetres, after so many sweeps.

    Attributes:
        grid_m: Depths to decide among.
        sweeps: Whole sweeps of each trial.
    """

    grid_m: tuple[float, ...]
    sweeps: int


@dataclass(frozen=True, eq=False)
class SchemeRun:
    """What a scheme did in a session.

    Attributes:
        ended: Its trials.
        shift: What was told of the session, if anything was; of policies that keep their ring, or traces.
        cpu_s: Seconds of one core a trial that deciding took, all trials at once; simulating what was felt is
            not in it.
    """

    ended: Outcomes
    shift: Shifted | None
    cpu_s: float


def run_plan(plan: WorldPlan, seed: tuple[int, ...], *, schemes: tuple[Scheme, ...]) -> dict[str, SchemeRun]:
    """Return what each scheme did in a session of a world."""
    return run_schemes(sessions_by_protocol(plan, seed), schemes)


def run_schemes(
    sessions: Callable[[Protocol], WorldSession], schemes: tuple[Scheme, ...], task: DepthTask | None = None
) -> dict[str, SchemeRun]:
    """Return what each scheme did in a session.

    Args:
        sessions: The session as a protocol sweeps it; of one luck.
        schemes: Which.
        task: A depth in place of a class; then a scheme's rule is its filter alone.
    """
    found: dict[str, SchemeRun] = {}
    features: dict[str, TrainedFeature] = {}
    traces: dict[tuple[str, str], tuple[TraceModel, TrainedTraces]] = {}
    whole = sessions(PAPER_PROTOCOL)
    for scheme in schemes:
        if scheme.reading == TRACE:
            session, of = sessions(scheme.steps), (scheme.protocol, scheme.trace_filter)
            if of not in traces:
                traces[of] = _trained(session, scheme, task)
            found[scheme.name] = _by_trace(session, scheme, _best_ring(features, whole), task, *traces[of])
            continue
        key = f"{scheme.reading}, {scheme.protocol}"
        if key not in features:
            grid_m = () if task is None else task.grid_m
            features[key] = train_feature(
                sessions(scheme.steps), scheme.reading, grid_m=grid_m, noise=ASSUMED
            )
        found[scheme.name] = _by_feature(features[key], scheme, task)
    return found


_CONTRAST = "contrast, paper"


def _best_ring(features: dict[str, TrainedFeature], session: WorldSession) -> int:
    """Return the position at which training's contrasts are best decided: a trace's too."""
    if _CONTRAST not in features:
        features[_CONTRAST] = train_feature(session, "contrast", noise=ASSUMED)
    return features[_CONTRAST].best_ring


def _by_feature(known: TrainedFeature, scheme: Scheme, task: DepthTask | None) -> SchemeRun:
    naive = scheme.rule == "paper"
    model = known.naive if naive else find("filter", "latent").target(known.latent)
    stop = _stop(scheme, task) or PosteriorThreshold(THRESHOLD)
    rings_m = known.trials.rings_m
    policy: StiffnessPolicy
    match scheme.policy:
        case "fixed_best":
            policy = FixedRing(rings_m[known.best_ring])
        case "uniform":
            policy = UniformRings(rings_m)
        case "markov":
            policy = MarkovPolicy()
        case _:
            policy = InformationGainLatent(model, rings_m)
    session = known.trials.session
    before = session.simulating.outside()
    ended = run_trials(known.trials, model, policy, stop, timing=scheme.steps.timing)
    spent_s = session.simulating.outside() - before
    count = len(ended.depth)
    keeps = scheme.policy == "fixed_best" and task is None
    shift = detect_shift(session, _read(known, ended)) if keeps else None
    return SchemeRun(ended, shift, spent_s / count)


def _read(known: TrainedFeature, ended: Outcomes) -> list[tuple[NDArray[np.int64], Projected]]:
    """Return trials at the best ring, by their first reading, as their session is held against training."""
    trials, ring = known.trials, known.best_ring
    every = np.arange(len(ended.depth))
    rings = np.full(len(every), ring)
    landed_m = trials.landing_m(every, 0, fixed=not trials.session.plan.conditions.rehome)
    values = trials.reading(every, rings, landed_m, 0)
    found = []
    for trial, (value, of) in enumerate(zip(values.tolist(), ended.estimate.tolist(), strict=True)):
        if one := by_readings(known.primitives, [(value, ring, True)], of, RING_SD_M):
            found.append((np.array([trial]), one))
    return found


def _stop(scheme: Scheme, task: DepthTask | None) -> StopRule | None:
    """Return the rule of whole sweeps; None: a threshold on the belief."""
    if task is not None:
        return FixedNumber(task.sweeps)
    return PaperVerbatim() if scheme.rule == "paper" else None


def _trained(
    session: WorldSession, scheme: Scheme, task: DepthTask | None
) -> tuple[TraceModel, TrainedTraces]:
    settings = settings_of(
        session, depths=0 if task is None else len(task.grid_m), trace_filter=scheme.trace_filter
    )
    learnt = learnt_of(session, settings)
    return model_of(session, settings, learnt), learnt


def _by_trace(
    session: WorldSession,
    scheme: Scheme,
    ring: int,
    task: DepthTask | None,
    model: TraceModel,
    learnt: TrainedTraces,
) -> SchemeRun:
    grid_m = () if task is None else task.grid_m
    selector: RingSelector
    match scheme.policy:
        case "fixed_best":
            selector = KeepRing(ring)
        case "uniform":
            selector = draw_rings(UniformRings(session.rings_m), session)
        case "markov":
            selector = draw_rings(MarkovPolicy(), session)
        case _:
            selector = MostInformation(session.rings_m, scheme.steps)
    stop = _stop(scheme, task)
    before = session.simulating.outside()
    done = run_trace_trials(
        session,
        model,
        scheme.steps,
        selector=selector,
        threshold=SURE,
        stop=stop,
        grid_m=grid_m,
        learnt=learnt if task is None else None,
    )
    spent_s = session.simulating.outside() - before
    count, shift = len(done.ended.depth), detect_shift(session, done.projected)
    return SchemeRun(done.ended, shift, spent_s / count)


def detect_shift(
    session: WorldSession, projected: Sequence[tuple[NDArray[np.int64], Projected]]
) -> Shifted | None:
    """Return what is told of a session whose trials come in an order drawn by chance; None: nothing."""
    of = {int(trial): (one, row) for trials, one in projected for row, trial in enumerate(trials)}
    so_far = SessionTrials()
    for trial in np.random.default_rng(len(of)).permutation(sorted(of)).tolist():
        one, row = of[trial]
        so_far.add(one, str(session.phantom[trial]), row)
        found = shifted(so_far, one) if so_far.due else None
        if found is not None and found.p < LOOK_P:
            return found
    return None
