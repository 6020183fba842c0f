"""Decide stored sessions again with other methods, without the rig: the sweeps are what was felt."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError, PerceptionError
from palp_core.methods import find
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.palpation.perception.belief.trial_filter import NAIVE
from palp_core.palpation.session.reading import FeatureReading, ReadingMemory, reading_of
from palp_core.palpation.session.reading_params import ReadingParams
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps
from palp_core.palpation.session.trace_settings import TraceSettings
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Methods:
    """Which methods, by name."""

    denoise: str = "soft_universal"  # task ``denoise``, of db10 at five levels
    feature: str = "peak"
    filter: str = "naive"  # task ``filter``: ``naive``, eq. (7), or one that knows what stays
    likelihood: str = "normal"  # task ``likelihood``; of the naive filter
    stop: str = "paper_guarded"
    stop_value: float = 0.0  # the stop rule's own number; 0 for its default
    max_probes: int = 15  # probes after which a trial is undecided
    depth_count: int = 0  # depths of a grid over the trained ones; 0 for the trained ones
    # task ``trace_filter``: the whole traces are the readings, and feature, filter and likelihood are not
    # used; empty: they are
    trace_filter: str = ""

    def __post_init__(self) -> None:
        for task in ("denoise", "feature", "filter", "likelihood", "stop"):
            find(task, getattr(self, task))
        if self.trace_filter:
            find("trace_filter", self.trace_filter)


@dataclass(frozen=True)
class ReanalysedTrial:
    """A trial decided again."""

    trial: int
    depth_m: float | None
    estimate_m: float
    confidence: float  # its probability
    probe_count: int  # stored sweeps that were used
    # ``decided``, ``undecided``, or ``ran_out`` where the rule wanted more sweeps than there are
    verdict: str
    expected_m: float  # mean depth of the belief
    posteriors: tuple[tuple[float, ...], ...] = ()  # the belief after each sweep


@dataclass(frozen=True, eq=False)
class ReanalysedSession:
    """A session decided again: what training taught, and every trial but the dropped ones, left out."""

    session: RecordedSweeps
    primitives: Primitives
    trials: tuple[ReanalysedTrial, ...]
    left_out: tuple[int, ...] = ()


def readings(sweeps: Sequence[RecordedSweep], methods: Methods) -> Float64Array:
    """Return the feature of each sweep, N m, shape (n,)."""
    reading, memory = _reading(RecordedSweeps(Path(), ()), methods, None, None), ReadingMemory()
    values = []
    for sweep in sweeps:
        _feel(reading, memory, sweep)
        values.append(reading.feature(memory).value_n_m)
    return np.array(values)


def reanalyse(
    session: RecordedSweeps, methods: Methods, *, noise: RigNoise | None = None, scene: Scene | None = None
) -> ReanalysedSession:
    """Learn from a session's training and decide its trials, each with its stored sweeps in their order."""
    if methods.filter != NAIVE and noise is None and not methods.trace_filter:
        raise PalpError(
            f"the filter '{methods.filter}' needs to know what stays: name a noise file with --noise "
            "(palp launch FILE plan:=repeatability writes one)"
        )
    reading, memory = _reading(session, methods, noise, scene), ReadingMemory()
    try:
        primitives = _learn(reading, memory, session)
        trials, left_out = [], []
        for number, group in groupby(session.phase("estimation"), key=attrgetter("trial")):
            sweeps = sorted(group, key=attrgetter("iteration"))
            if any(reading.setting(memory, sweep.ring_m) is None for sweep in sweeps):
                left_out.append(number)  # the session dropped it, too
            else:
                trials.append(_decide(reading, memory, sweeps, methods.max_probes))
    except PerceptionError as error:
        raise PalpError(f"{session.path}: {error}") from error
    if not trials and not left_out:
        raise PalpError(f"{session.path}: has no trial of estimation to decide again")
    return ReanalysedSession(session, primitives, tuple(trials), tuple(left_out))


def _reading(
    session: RecordedSweeps, methods: Methods, noise: RigNoise | None, scene: Scene | None
) -> FeatureReading:
    """Return the reading of methods; of whole traces along the path and with the spreads that it states."""
    known: dict[str, Any] = {}
    if methods.trace_filter:
        if not session.read_by:
            raise PalpError(
                f"{session.path}: run.json is missing, and with it the path of the sweeps; traces need it"
            )
        names = TraceSettings.__struct_fields__
        known = {name: value for name, value in session.read_by.items() if name in names}
        known["reading"] = "trace"
    params = ReadingParams(**known | {"stop_value": methods.stop_value, "depths": methods.depth_count})
    return reading_of(params, asdict(methods), noise, scene)


def _learn(reading: FeatureReading, memory: ReadingMemory, session: RecordedSweeps) -> Primitives:
    known = [(sweep, sweep.depth_m) for sweep in session.phase("training") if sweep.depth_m is not None]
    if not known:
        raise PalpError(
            f"{session.path}: has no training sweeps with known depths; there is nothing to learn from"
        )
    for sweep, depth_m in known:
        memory.begin_trial(sweep.phantom)
        _feel(reading, memory, sweep)
        reading.teach(memory, depth_m, sweep.ring_m, reading.feature(memory).value_n_m)
    return reading.learn(memory)


def _feel(reading: FeatureReading, memory: ReadingMemory, sweep: RecordedSweep) -> None:
    """Have a reading take a stored sweep, as far as it goes or is needed."""
    enter_ns, leave_ns = sweep.enter_ns or 0, sweep.leave_ns or 0
    if reading.follows and not (leave_ns and sweep.start_ns is not None):
        raise PerceptionError("the times at which a sweep was over the path are missing; traces need them")
    reading.begin(memory, enter_ns, leave_ns)
    reading.add(memory, sweep.start_ns or 0, sweep.rate_hz, sweep.torque_n_m)
    reading.end(memory)


def _decide(
    reading: FeatureReading, memory: ReadingMemory, sweeps: Sequence[RecordedSweep], max_probes: int
) -> ReanalysedTrial:
    memory.begin_trial()
    word = "ran_out"
    for sweep in sweeps:
        _feel(reading, memory, sweep)
        reading.look(memory, sweep.ring_m, landed=sweep.landed)
        # one that was decided early may be too short for a feature, which a trace has no use for
        value_n_m = 0.0 if reading.follows else reading.feature(memory).value_n_m
        reading.posterior(memory, sweep.ring_m, value_n_m, landed=sweep.landed)
        verdict = reading.verdict(memory, max_probes)
        if verdict.word != "continue":
            word = verdict.word
            break
    last, depths_m = np.array(memory.posteriors[-1]), reading.depths_m(memory)
    best = int(np.argmax(last))
    return ReanalysedTrial(
        sweeps[0].trial,
        sweeps[0].depth_m,
        float(depths_m[best]),
        float(last[best]),
        len(memory.posteriors),
        word,
        float(last @ depths_m),
        tuple(tuple(row) for row in memory.posteriors),
    )
