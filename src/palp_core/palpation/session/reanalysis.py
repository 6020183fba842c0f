"""Decide stored sessions again with other methods, without the rig: the sweeps are what was felt."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from palp_core.errors import PalpError, PerceptionError
from palp_core.methods import find
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief import bayes
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.primitives import Primitives, fit, quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.palpation.perception.belief.stopping import decide, stop_rule
from palp_core.palpation.perception.belief.trial_filter import NAIVE, TrialFilter, TrialReading
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.strategy.trained_rings import untrained
from palp_core.palpation.session.filters import filter_of
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps
from palp_core.palpation.session.trace.again import decide_again, trace_reader
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Methods:
    """Which methods, by name.

    Attributes:
        denoise: Task ``denoise``, of db10 at five levels.
        feature: Task ``feature``.
        filter: Task ``filter``: ``naive``, eq. (7), or one that knows what stays.
        likelihood: Task ``likelihood``; of the naive filter.
        stop: Task ``stop``.
        stop_value: The stop rule's own number; 0 for its default.
        max_probes: Probes after which a trial is undecided.
        depth_count: Depths of a grid over the trained ones; 0 for the trained ones.
        trace_filter: Task ``trace_filter``: the whole traces are the readings, and feature, filter and
            likelihood are not used; empty: they are.
    """

    denoise: str = "soft_universal"
    feature: str = "peak"
    filter: str = "naive"
    likelihood: str = "normal"
    stop: str = "paper_guarded"
    stop_value: float = 0.0
    max_probes: int = 15
    depth_count: int = 0
    trace_filter: str = ""

    def __post_init__(self) -> None:
        for task in ("denoise", "feature", "filter", "likelihood", "stop"):
            find(task, getattr(self, task))
        if self.trace_filter:
            find("trace_filter", self.trace_filter)


@dataclass(frozen=True)
class ReanalysedTrial:
    """A trial decided again.

    Attributes:
        trial: Its number.
        depth_m: True depth; None where nobody told.
        estimate_m: Most probable depth.
        confidence: Its probability.
        probe_count: Stored sweeps that were used.
        verdict: ``decided``, ``undecided``, or ``ran_out`` where the rule wanted more sweeps than there are.
        expected_m: Mean depth of the belief.
    """

    trial: int
    depth_m: float | None
    estimate_m: float
    confidence: float
    probe_count: int
    verdict: str
    expected_m: float


@dataclass(frozen=True, eq=False)
class ReanalysedSession:
    """A session decided again: what training taught, and every trial but the dropped ones, left out."""

    session: RecordedSweeps
    primitives: Primitives
    trials: tuple[ReanalysedTrial, ...]
    left_out: tuple[int, ...] = ()


def readings(sweeps: Sequence[RecordedSweep], methods: Methods) -> Float64Array:
    """Return the feature of each sweep, N m, shape (n,).

    Raises:
        PerceptionError: A sweep is too short, or holds NaN.
    """
    feature, edge = find("feature", methods.feature).target, edge_cone()
    clean = (denoise(sweep.torque_n_m, rule=methods.denoise) for sweep in sweeps)
    return np.array([feature(torque_n_m, edge=edge).value_n_m for torque_n_m in clean])


def learn(sweeps: Sequence[RecordedSweep], values: Float64Array, where: object) -> Primitives:
    """Return the memory primitives of training sweeps."""
    known = [(s, v) for s, v in zip(sweeps, values.tolist(), strict=True) if s.depth_m is not None]
    if not known:
        raise PalpError(f"{where}: has no training sweeps with known depths; there is nothing to learn from")
    depths_m = sorted({float(s.depth_m or 0.0) for s, _ in known})
    rings_m = sorted({s.ring_m for s, _ in known})
    try:
        return fit(
            np.array([v for _, v in known]),
            [depths_m.index(float(s.depth_m or 0.0)) for s, _ in known],
            [rings_m.index(s.ring_m) for s, _ in known],
            depths_m=depths_m,
            rings_m=rings_m,
            floor=quantisation_sd(RESOLUTION_N_M),
        )
    except PerceptionError as error:
        raise PalpError(f"{where}: {error}") from error


def reanalyse(
    session: RecordedSweeps, methods: Methods, *, noise: RigNoise | None = None, scene: Scene | None = None
) -> ReanalysedSession:
    """Learn from a session's training and decide its trials, each with its stored sweeps in their order.

    Args:
        session: The sweeps.
        methods: Which methods.
        noise: What stays; the latent filter needs it.
        scene: Gel, probe and indentation, from which the latent filter takes how a reading answers to the
            phantom's height; None: the default scene, assumed.
    """
    training, estimation = session.phase("training"), session.phase("estimation")
    primitives = learn(training, readings(training, methods), session.path)
    if not estimation:
        raise PalpError(f"{session.path}: has no trial of estimation to decide again")
    if methods.trace_filter:
        return _by_traces(session, methods, primitives, noise, scene)
    values = dict(zip(map(id, estimation), readings(estimation, methods).tolist(), strict=True))
    if methods.filter != NAIVE and noise is None:
        raise PalpError(
            f"the filter '{methods.filter}' needs to know what stays: name a noise file with --noise "
            "(palp launch FILE plan:=repeatability writes one)"
        )
    belief = filter_of(
        primitives,
        methods.filter,
        likelihood=methods.likelihood,
        depth_count=methods.depth_count,
        feature=methods.feature,
        noise=noise,
        scene=scene,
    )
    trials = []
    left_out = []
    for number, group in groupby(estimation, key=lambda sweep: sweep.trial):
        sweeps = sorted(group, key=lambda sweep: sweep.iteration)
        if untrained([sweep.ring_m for sweep in sweeps], primitives.rings_m.tolist()):
            left_out.append(number)  # the session dropped it, too
            continue
        trials.append(_decide(number, sweeps, [values[id(s)] for s in sweeps], belief, methods))
    return ReanalysedSession(session, primitives, tuple(trials), tuple(left_out))


def _by_traces(
    session: RecordedSweeps,
    methods: Methods,
    primitives: Primitives,
    noise: RigNoise | None,
    scene: Scene | None,
) -> ReanalysedSession:
    """Decide the trials by their whole traces, along the path and with the spreads that it states."""
    if not session.read_by:
        raise PalpError(
            f"{session.path}: does not say over which path it swept (run.json is missing): nothing lays its "
            "traces along one"
        )
    settings = replace(
        TraceSettings.of(session.read_by), depths=methods.depth_count, trace_filter=methods.trace_filter
    )
    try:
        reader = trace_reader(session, settings, noise, scene)
    except PerceptionError as error:
        raise PalpError(f"{session.path}: {error}") from error
    rule, depths_m = stop_rule(methods.stop, methods.stop_value), reader.depths_m
    trials, left_out = [], []
    for one in decide_again(session, reader, settings, rule, methods.max_probes):
        if not one.posteriors:
            left_out.append(one.trial)
            continue
        last = one.posteriors[-1]
        best = int(np.argmax(last))
        trials.append(
            ReanalysedTrial(
                one.trial,
                one.sweeps[0].depth_m,
                float(depths_m[best]),
                float(last[best]),
                len(one.posteriors),
                one.word,
                float(last @ depths_m),
            )
        )
    return ReanalysedSession(session, primitives, tuple(trials), tuple(left_out))


def _decide(
    number: int,
    sweeps: Sequence[RecordedSweep],
    values: Sequence[float],
    belief: TrialFilter,
    methods: Methods,
) -> ReanalysedTrial:
    rings_m, depths_m = belief.primitives.rings_m, belief.primitives.depths_m
    rule, flat = stop_rule(methods.stop, methods.stop_value), np.exp(bayes.flat_prior(depths_m.size))
    probes: list[TrialReading] = []
    posteriors: list[Float64Array] = []
    gains: list[Float64Array] = []
    word = "ran_out"
    for sweep, value in zip(sweeps, values, strict=True):
        ring = int(np.flatnonzero(np.isclose(rings_m, sweep.ring_m, atol=1e-9))[0])
        probes.append(TrialReading(value, ring, sweep.landed or not probes or ring != probes[-1].setting))
        posteriors.append(belief.posterior(probes))
        gains.append(gain_vector(posteriors[-1], flat))
        verdict = decide(rule, posteriors, gains, max_probes=methods.max_probes)
        if verdict.word != "continue":
            word = verdict.word
            break
    best = int(np.argmax(posteriors[-1]))
    return ReanalysedTrial(
        number,
        sweeps[0].depth_m,
        float(depths_m[best]),
        float(posteriors[-1][best]),
        len(posteriors),
        word,
        float(posteriors[-1] @ depths_m),
    )
