"""The ways to decide that are compared: what is read, who chooses the ring, which filter, when to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from palp_core.methods import find
from palp_core.palpation.perception.belief.rig_noise import (
    assumed_noise,
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
    """

    reading: str
    policy: str
    rule: str
    protocol: str = "paper"

    @property
    def name(self) -> str:
        """As in tables: ``trace, fixed_best, threshold, swift``."""
        words = [self.reading, self.policy, self.rule]
        words += [self.protocol] * (self.protocol != "paper")
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
        cpu_s: Seconds of one core a trial that deciding took, all trials at once; simulating what was felt is
            not in it.
    """

    ended: Outcomes
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
    traces: dict[str, TraceModel] = {}
    whole = sessions(PAPER_PROTOCOL)
    for scheme in schemes:
        if scheme.reading == TRACE:
            session, of = sessions(scheme.steps), scheme.protocol
            if of not in traces:
                traces[of] = _trained(session, task)
            found[scheme.name] = _by_trace(session, scheme, _best_ring(features, whole), task, traces[of])
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
    return SchemeRun(ended, spent_s / count)


def _stop(scheme: Scheme, task: DepthTask | None) -> StopRule | None:
    """Return the rule of whole sweeps; None: a threshold on the belief."""
    if task is not None:
        return FixedNumber(task.sweeps)
    return PaperVerbatim() if scheme.rule == "paper" else None


def _trained(session: WorldSession, task: DepthTask | None) -> TraceModel:
    settings = settings_of(session, depths=0 if task is None else len(task.grid_m))
    return model_of(session, settings)


def _by_trace(
    session: WorldSession,
    scheme: Scheme,
    ring: int,
    task: DepthTask | None,
    model: TraceModel,
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
    )
    spent_s = session.simulating.outside() - before
    return SchemeRun(done.ended, spent_s / len(done.ended.depth))
