"""A trial's sweeps read bin by bin, and the decision within a sweep: the same live and in a re-analysis.

What was felt is kept as bins, plain data; a belief is always that of these bins, whoever makes it and however
many at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief import bayes
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.palpation.perception.belief.session_check import Projected
from palp_core.palpation.perception.belief.stopping import BeliefStep, StopRule
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.perception.trace import belief as trace_belief
from palp_core.palpation.perception.trace.bins import BinnedSweep, Int64Array
from palp_core.palpation.perception.trace.check import projected
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.training import TrainedTraces, learn
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.units import Float64Array

_ALIKE = 1e-9  # metres, or metres a second

STRANGE = 0.01
"""Torques that fit no worse are more probable than this; others are said not to fit."""


class TaughtSweep(msgspec.Struct, frozen=True):
    """A sweep of training: where it was, in which mounting, and the torque of its bins, N m."""

    depth_m: float
    ring_m: float
    mounting: int
    torque_n_m: list[float]


class FeltSweep(msgspec.Struct, frozen=True):
    """A sweep of a trial.

    Attributes:
        ring_m: Its ring position.
        landed: Whether the ring was moved, or re-homed, since the sweep before.
        torque_n_m: Mean torque of each bin that counts, N m.
    """

    ring_m: float
    landed: bool
    torque_n_m: list[float]


class SweepUnderWay(msgspec.Struct):
    """A sweep that is being felt; plain data for a successor.

    Attributes:
        enter_ns: When the stage comes over the path, as told when the sweep began.
        leave_ns: When it leaves it.
        bins: The torque so far.
        seen: Bins after which the belief was asked.
        decided: Bins after which the stop rule was passed; 0: it was not.
        over: Whether stage or experiment have ended it.
        whole: Whether it was swept to its end.
    """

    enter_ns: int
    leave_ns: int
    bins: BinnedSweep = msgspec.field(default_factory=BinnedSweep)
    seen: int = 0
    decided: int = 0
    over: bool = False
    whole: bool = False

    def add(self, settings: TraceSettings, times_ns: Int64Array, torque_n_m: Float64Array) -> None:
        """Take samples in their order: the stage goes at constant speed between the two times."""
        if self.leave_ns <= self.enter_ns:
            raise PerceptionError("a sweep over the path takes no time; the stage must tell when it is there")
        done = (times_ns - self.enter_ns) / (self.leave_ns - self.enter_ns)
        way_m = settings.from_m + (settings.to_m - settings.from_m) * done
        self.bins.add(settings.bins, way_m, torque_n_m)

    def finish(self, settings: TraceSettings) -> None:
        """Complete the bin that it ended in, if that is the last of its path."""
        self.bins.finish(settings.bins)

    def all_here(self, received: int, expected: int, stream: SweepCut | None) -> bool:
        """Tell whether it is over and its torque is here.

        Args:
            received: Samples that came.
            expected: How many the stage counted; 0 where the torque streams.
            stream: The stream.
        """
        if not self.over or received < expected:
            return False
        return bool(expected) or stream is None or not self.whole or stream.complete

    def felt(self, ring_m: float, *, landed: bool) -> FeltSweep:
        """Return it as a sweep of the trial: its bins up to the decision count, or all there are."""
        return FeltSweep(ring_m, landed, self.bins.done[: self.decided or None])


class TraceMemory(msgspec.Struct):
    """What a node that reads traces hands over: training, this trial's sweeps, the sweep under way.

    Training's mountings are told apart by the phantom's code: one that is put on again right after itself
    counts as the same mounting.
    """

    training: list[TaughtSweep] = []
    mounting: int = 0
    code: str = ""
    felt: list[FeltSweep] = []
    sweep: SweepUnderWay | None = None

    def require(self, *, traces: bool) -> None:
        """Refuse a reading that training, which there was, was not read with."""
        if traces != bool(self.training):
            raise PerceptionError("training was read otherwise (reading: feature or trace); keep its reading")

    def begin_trial(self, code: str) -> None:
        """Forget what was felt; a sweep that is still under way belongs to no trial."""
        if code and code != self.code:
            self.mounting, self.code = self.mounting + 1, code
        self.felt, self.sweep = [], None

    def lands(self, ring_m: float) -> bool:
        """Tell whether the ring comes anew to a position, by the trial's sweeps alone."""
        return not self.felt or abs(self.felt[-1].ring_m - ring_m) > _ALIKE

    def teach(self, depth_m: float, ring_m: float, settings: TraceSettings) -> bool:
        """Keep the sweep under way as one of training; return whether it reached the path's end."""
        done = self.sweep.bins.done if self.sweep is not None else []
        if len(done) < settings.bins.count:
            return False
        self.training.append(TaughtSweep(depth_m, ring_m, self.mounting, done))
        return True


def trained_traces(training: Sequence[TaughtSweep], settings: TraceSettings) -> TrainedTraces:
    """Return what the sweeps of training teach."""
    if not training:
        raise PerceptionError("no whole sweep of training is known by its trace; train with reading: trace")
    return learn(
        np.array([one.torque_n_m for one in training]),
        [one.depth_m for one in training],
        [one.ring_m for one in training],
        [one.mounting for one in training],
        floor_n_m=settings.floor_n_m,
    )


def reader_of(
    training: Sequence[TaughtSweep],
    settings: TraceSettings,
    *,
    noise: RigNoise | None = None,
    scene: Scene | None = None,
) -> TraceReader:
    """Return what reads trials as training and settings have it.

    Args:
        training: Its sweeps.
        settings: How they are read.
        noise: In place of the settings' spreads of landing and height.
        scene: In place of the settings' scene.
    """
    trained = trained_traces(training, settings)
    depths_m = classes_of(trained.depths_m.tolist(), settings.depths)
    model = settings.model(trained, noise, scene)
    return TraceReader(model, depths_m, trained.rings_m, None if settings.depths else trained)


@dataclass(frozen=True)
class TraceSoFar:
    """What the torque so far says.

    Attributes:
        posterior: Of the classes, shape (m,).
        bins: How many of the sweep's bins it is from.
        decided: Whether the stop rule is passed there.
    """

    posterior: Float64Array
    bins: int
    decided: bool


@dataclass(eq=False)
class TraceReader:
    """Beliefs of a trial's bins under a model; what it remembers saves time and changes nothing.

    Attributes:
        model: What sweeps look like.
        depths_m: Of the classes.
        rings_m: Trained positions of the ring.
        trained: What training taught; None where classes or settings are not those of training.
    """

    model: TraceModel
    depths_m: Float64Array
    rings_m: Float64Array
    trained: TrainedTraces | None = None
    _last: tuple[list[FeltSweep], trace_belief.TraceBelief] | None = field(default=None, init=False)

    @property
    def flat(self) -> Float64Array:
        """Probabilities of the classes before a trial, shape (m,)."""
        return np.exp(bayes.flat_prior(len(self.depths_m)))

    def setting(self, ring_m: float) -> int | None:
        """Return the model's setting of a ring position, or None if that was not trained."""
        found = np.flatnonzero(np.isclose(self.rings_m, ring_m, atol=_ALIKE))
        return int(found[0]) if len(found) else None

    def belief(self, felt: Sequence[FeltSweep]) -> trace_belief.TraceBelief:
        """Return the belief of the bins of a trial's sweeps."""
        found, done = self._resumed(felt)
        for number, sweep in enumerate(felt):
            known = done[number] if number < len(done) else -1
            if known < 0:
                found, known = trace_belief.begin_sweep(found, self._setting(sweep), landed=sweep.landed), 0
            if rest := sweep.torque_n_m[known:]:
                found = trace_belief.observe(self.model, found, rest)
        self._last = (list(felt), found)
        return found

    def _setting(self, sweep: FeltSweep) -> int:
        found = self.setting(sweep.ring_m)
        if found is None:
            raise PerceptionError(f"a sweep of which nothing was learnt: ring at {sweep.ring_m * 1e3:g} mm")
        return found

    def _resumed(self, felt: Sequence[FeltSweep]) -> tuple[trace_belief.TraceBelief, list[int]]:
        """Return the last belief and how many bins of each sweep it has, if these go on from there."""
        fresh = trace_belief.start(self.model)
        if self._last is None:
            return fresh, []
        before, found = self._last
        if not before or len(felt) < len(before) or list(felt[: len(before) - 1]) != before[:-1]:
            return fresh, []
        *earlier, last = before
        same, count = felt[len(earlier)], len(last.torque_n_m)
        alike = (same.ring_m, same.landed) == (last.ring_m, last.landed)
        if not alike or same.torque_n_m[:count] != last.torque_n_m:
            return fresh, []
        return found, [len(one.torque_n_m) for one in before]

    def posterior(self, felt: Sequence[FeltSweep]) -> Float64Array:
        """Return the probabilities of the classes, shape (m,)."""
        return np.asarray(trace_belief.classes(self.model, self.belief(felt).log_density)[0])

    def fits(self, felt: Sequence[FeltSweep]) -> bool:
        """Tell whether the best class explains the torques."""
        return bool(trace_belief.fit_probability(self.model, self.belief(felt))[0] >= STRANGE)

    def against_training(self, felt: Sequence[FeltSweep]) -> Projected | None:
        """Return a trial as its session is held against training by it.

        None where there is nothing to hold it against.
        """
        if self.trained is None or not felt:
            return None
        found = self.belief(felt)
        of = int(np.argmax(trace_belief.classes(self.model, found.log_density)[0]))
        return projected(self.model, self.trained, found, of)

    def look(
        self,
        earlier: Sequence[FeltSweep],
        sweep: FeltSweep,
        seen: int,
        rule: StopRule,
        posteriors: Sequence[Float64Array],
    ) -> TraceSoFar:
        """Return what a sweep says after the bins that nobody has looked at yet, or after that which decides.

        Args:
            earlier: Sweeps of the trial before it.
            sweep: It, as far as it is felt.
            seen: How many of its bins were looked at before.
            rule: The stop rule; one that counts probes is asked when a sweep is over only.
            posteriors: After each of the sweeps before it.
        """
        found, count = self.flat, len(sweep.torque_n_m)
        for bins in range(min(seen + 1, count) if rule.within_a_sweep else count, count + 1):
            so_far = FeltSweep(sweep.ring_m, sweep.landed, sweep.torque_n_m[:bins])
            found = self.posterior([*earlier, so_far])
            if rule.within_a_sweep:
                history = [*posteriors, found]
                step = BeliefStep.last(history, [gain_vector(one, self.flat) for one in history])
                if bool(rule.check(step).converged):
                    return TraceSoFar(found, bins, decided=True)
        return TraceSoFar(found, count, decided=False)
