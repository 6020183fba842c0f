"""Decide stored sweeps again by their whole traces: a node's own verdicts where its methods are asked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from msgspec import structs

from palp_core.errors import PalpError
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.palpation.perception.belief.stopping import StopRule, decide
from palp_core.palpation.perception.trace.bins import sample_times_ns
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps
from palp_core.palpation.session.trace.reader import (
    SweepUnderWay,
    TaughtSweep,
    TraceMemory,
    TraceReader,
    reader_of,
)
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class TracedTrial:
    """A trial decided again by its traces.

    Attributes:
        trial: Its number.
        sweeps: Its stored sweeps.
        posteriors: After each sweep that was used, shape (m,); none where a ring was not trained.
        word: The verdict; ``ran_out`` where the rule wanted more sweeps than there are.
    """

    trial: int
    sweeps: tuple[RecordedSweep, ...]
    posteriors: tuple[Float64Array, ...]
    word: str


def trace_reader(
    session: RecordedSweeps,
    settings: TraceSettings,
    noise: RigNoise | None,
    scene: Scene | None,
) -> TraceReader:
    """Return what reads a session's trials, as its training taught it."""
    return reader_of(_taught(session, settings), settings, noise=noise, scene=scene)


def _taught(session: RecordedSweeps, settings: TraceSettings) -> list[TaughtSweep]:
    memory = TraceMemory()
    for sweep in session.phase("training"):
        memory.begin_trial(sweep.phantom)
        memory.sweep = felt_of(session, sweep, settings)
        memory.teach(sweep.depth_m or 0.0, sweep.ring_m, settings)
    return memory.training


def decide_again(
    session: RecordedSweeps, reader: TraceReader, settings: TraceSettings, rule: StopRule, max_probes: int
) -> Iterator[TracedTrial]:
    """Yield the trials of a session, each decided with its stored sweeps in their order."""
    for number, group in groupby(session.phase("estimation"), key=lambda sweep: sweep.trial):
        sweeps = tuple(sorted(group, key=lambda sweep: sweep.iteration))
        if any(reader.setting(sweep.ring_m) is None for sweep in sweeps):
            yield TracedTrial(number, sweeps, (), "dropped")
        else:
            yield TracedTrial(number, sweeps, *_decide(session, sweeps, reader, settings, rule, max_probes))


def _decide(
    session: RecordedSweeps,
    sweeps: Sequence[RecordedSweep],
    reader: TraceReader,
    settings: TraceSettings,
    rule: StopRule,
    max_probes: int,
) -> tuple[tuple[Float64Array, ...], str]:
    memory, posteriors = TraceMemory(), list[Float64Array]()
    for sweep in sweeps:
        felt = felt_of(session, sweep, settings)
        whole = felt.felt(sweep.ring_m, landed=memory.lands(sweep.ring_m) or sweep.landed)
        seen = reader.look(memory.felt, whole, 0, rule, posteriors)
        memory.felt.append(structs.replace(whole, torque_n_m=whole.torque_n_m[: seen.bins]))
        posteriors.append(seen.posterior)
        gains = [gain_vector(one, reader.flat) for one in posteriors]
        verdict = decide(rule, posteriors, gains, max_probes=max_probes)
        if verdict.word != "continue":
            return tuple(posteriors), verdict.word
    return tuple(posteriors), "ran_out"


def felt_of(session: RecordedSweeps, sweep: RecordedSweep, settings: TraceSettings) -> SweepUnderWay:
    """Return a stored sweep in bins, as far as it goes."""
    if sweep.enter_ns is None or sweep.leave_ns is None or sweep.start_ns is None:
        raise PalpError(
            f"{session.path}: does not tell when a sweep came over the path and left it, as earlier "
            "versions; its traces cannot be laid along the path"
        )
    felt = SweepUnderWay(sweep.enter_ns, sweep.leave_ns)
    times_ns = sample_times_ns(sweep.start_ns, sweep.rate_hz, 0, len(sweep.torque_n_m))
    felt.add(settings, times_ns, sweep.torque_n_m)
    felt.finish(settings)
    return felt
