"""A trial's sweeps read bin by bin, and the decision within a sweep: the same live and in a re-analysis.

What was felt is kept as bins, plain data; a belief is always that of these bins, whoever makes it and however
many at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

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
from palp_core.palpation.perception.trace.actions import ActionModel, LoadLimits, SweepAction
from palp_core.palpation.perception.trace.bins import BinnedSweep, Int64Array
from palp_core.palpation.perception.trace.check import projected
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.terms import Offer, SweepTerms
from palp_core.palpation.perception.trace.training import TrainedTraces, learn
from palp_core.palpation.session.trace.actions import action_model
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
        torque_n_m: Mean torque of each bin that counts, N m; of one against training's way with other sign.
        terms: How it was made; None: as training's.
    """

    ring_m: float
    landed: bool
    torque_n_m: list[float]
    terms: SweepTerms | None = None


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
        terms: How it is made; None: as training's.
    """

    enter_ns: int
    leave_ns: int
    bins: BinnedSweep = msgspec.field(default_factory=BinnedSweep)
    seen: int = 0
    decided: int = 0
    over: bool = False
    whole: bool = False
    terms: SweepTerms | None = None

    def along(self, settings: TraceSettings) -> TraceSettings:
        """Return the settings on the path of this sweep."""
        if self.terms is None:
            return settings
        return replace(settings, from_m=self.terms.from_m, to_m=self.terms.to_m)

    def sign(self, settings: TraceSettings) -> float:
        """Return -1.0 for a sweep against the way of training, else 1.0."""
        own = self.along(settings)
        return 1.0 if (own.to_m - own.from_m) * (settings.to_m - settings.from_m) > 0.0 else -1.0

    def add(self, settings: TraceSettings, times_ns: Int64Array, torque_n_m: Float64Array) -> None:
        """Take samples in their order: the stage goes at constant speed between the two times.

        Raises:
            PerceptionError: A torque is not a number, or the sweep takes no time.
        """
        if self.leave_ns <= self.enter_ns:
            raise PerceptionError("a sweep over the path takes no time; the stage must tell when it is there")
        done = (times_ns - self.enter_ns) / (self.leave_ns - self.enter_ns)
        own = self.along(settings)
        self.bins.add(own.bins, own.from_m + (own.to_m - own.from_m) * done, torque_n_m)

    def finish(self, settings: TraceSettings) -> None:
        """Complete the bin that it ended in, if that is the last of its path."""
        self.bins.finish(self.along(settings).bins)

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

    def felt(self, settings: TraceSettings, ring_m: float, *, landed: bool) -> FeltSweep:
        """Return it as a sweep of the trial: its bins up to the decision count, or all there are."""
        sign, done = self.sign(settings), self.bins.done[: self.decided or None]
        torque_n_m = done if sign > 0.0 else [-one for one in done]
        return FeltSweep(ring_m, landed, torque_n_m, self.terms)


class TraceMemory(msgspec.Struct):
    """What a node that reads traces hands over: training, this trial's sweeps, the sweep under way.

    Training's mountings are told apart by the phantom's code: one that is put on again right after itself
    counts as the same mounting. ``offer`` is what this trial's sweeps are chosen from, if anybody chooses.
    """

    training: list[TaughtSweep] = []
    mounting: int = 0
    code: str = ""
    felt: list[FeltSweep] = []
    sweep: SweepUnderWay | None = None
    offer: Offer | None = None

    def require(self, *, traces: bool) -> None:
        """Refuse a reading that training, which there was, was not read with.

        Raises:
            PerceptionError: It is not the same.
        """
        if traces != bool(self.training):
            raise PerceptionError("training was read otherwise (reading: feature or trace); keep its reading")

    def begin_trial(self, code: str) -> None:
        """Forget what was felt; a sweep that is still under way belongs to no trial."""
        if code and code != self.code:
            self.mounting, self.code = self.mounting + 1, code
        self.felt, self.sweep, self.offer = [], None, None

    def lands(self, ring_m: float) -> bool:
        """Tell whether the ring comes anew to a position, by the trial's sweeps alone."""
        return not self.felt or abs(self.felt[-1].ring_m - ring_m) > _ALIKE

    def teach(self, depth_m: float, ring_m: float, settings: TraceSettings) -> bool:
        """Keep the sweep under way as one of training; return whether it reached the path's end."""
        done = self.sweep.bins.done if self.sweep is not None and self.sweep.terms is None else []
        if len(done) < settings.bins.count:
            return False
        self.training.append(TaughtSweep(depth_m, ring_m, self.mounting, done))
        return True


def trained_traces(training: Sequence[TaughtSweep], settings: TraceSettings) -> TrainedTraces:
    """Return what the sweeps of training teach.

    Raises:
        PerceptionError: There are none, or a cell has none.
    """
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

    Raises:
        PerceptionError: As of :func:`trained_traces` and :meth:`TraceSettings.model`.
        MethodError: As of the latter.
    """
    trained = trained_traces(training, settings)
    depths_m = classes_of(trained.depths_m.tolist(), settings.depths)
    model = settings.model(trained, noise, scene)
    return TraceReader(model, depths_m, trained.rings_m, None if settings.depths else trained)


def action_reader(
    training: Sequence[TaughtSweep],
    settings: TraceSettings,
    actions: Sequence[SweepAction],
    home: SweepTerms,
    limits: LoadLimits,
    *,
    noise: RigNoise | None = None,
    scene: Scene | None = None,
) -> TraceReader:
    """Return what reads trials whose sweeps are chosen; further arguments and errors as of :func:`reader_of`.

    Args:
        training: Its sweeps.
        settings: How they are read.
        actions: What may have been swept, or may be.
        home: How training's sweeps were made.
        limits: Of what may be asked for.
        noise: In place of the settings' spreads.
        scene: In place of the settings' scene.

    Raises:
        PerceptionError: No action is left within the limits.
    """
    trained = trained_traces(training, settings)
    speed = home.speed_m_per_s
    known = action_model(settings, trained, actions, limits, noise=noise, scene=scene, speed_m_per_s=speed)
    depths_m = classes_of(trained.depths_m.tolist(), settings.depths)
    return TraceReader(known.model, depths_m, trained.rings_m, None, known, home)


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
        known: Of trials whose sweeps are chosen: what may be; the settings are its.
        home: How training's sweeps were made, where that is told.
    """

    model: TraceModel
    depths_m: Float64Array
    rings_m: Float64Array
    trained: TrainedTraces | None = None
    known: ActionModel | None = None
    home: SweepTerms | None = None
    _first: Float64Array | None = field(default=None, init=False)
    _last: tuple[list[FeltSweep], trace_belief.TraceBelief] | None = field(default=None, init=False)

    @property
    def flat(self) -> Float64Array:
        """Probabilities of the classes before a trial, shape (m,)."""
        return np.exp(bayes.flat_prior(len(self.depths_m)))

    def setting(self, ring_m: float, terms: SweepTerms | None = None) -> int | None:
        """Return the model's setting of a sweep, or None if it has none: a ring that was not trained, say."""
        terms = terms or self.home
        if self.known is None:
            found = np.flatnonzero(np.isclose(self.rings_m, ring_m, atol=_ALIKE))
            return int(found[0]) if len(found) and terms is None else None
        assert terms is not None
        number = index_of(terms.at(ring_m), self.known.offered)
        return None if number is None else self.known.setting[number]

    def expected_bits(self, felt: Sequence[FeltSweep], actions: Sequence[SweepAction]) -> Float64Array:
        """Return what each action is expected to tell a trial next, shape (a,), bits; -1.0: not on offer."""
        assert self.known is not None
        bits = self._first if not felt else None
        if bits is None:
            bits = self.known.expected_bits(self.belief(felt), felt[-1].ring_m if felt else None)[0]
        if not felt:
            self._first = bits  # alike for all trials
        on_offer = dict(zip(self.known.offered, bits.tolist(), strict=True))
        return np.array([on_offer.get(action, -1.0) for action in actions])

    def belief(self, felt: Sequence[FeltSweep]) -> trace_belief.TraceBelief:
        """Return the belief of the bins of a trial's sweeps.

        Raises:
            PerceptionError: A sweep is none of the model's, has more bins than it, or a torque is not finite.
        """
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
        found = self.setting(sweep.ring_m, sweep.terms)
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
        alike = (same.ring_m, same.landed, same.terms) == (last.ring_m, last.landed, last.terms)
        if not alike or same.torque_n_m[:count] != last.torque_n_m:
            return fresh, []
        return found, [len(one.torque_n_m) for one in before]

    def posterior(self, felt: Sequence[FeltSweep]) -> Float64Array:
        """Return the probabilities of the classes, shape (m,); errors as of :meth:`belief`."""
        return np.asarray(trace_belief.classes(self.model, self.belief(felt).log_density)[0])

    def fits(self, felt: Sequence[FeltSweep]) -> bool:
        """Tell whether the best class explains the torques; errors as of :meth:`belief`."""
        return bool(trace_belief.fit_probability(self.model, self.belief(felt))[0] >= STRANGE)

    def against_training(self, felt: Sequence[FeltSweep]) -> Projected | None:
        """Return a trial as its session is held against training by it; errors as of :meth:`belief`.

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
            so_far = FeltSweep(sweep.ring_m, sweep.landed, sweep.torque_n_m[:bins], sweep.terms)
            found = self.posterior([*earlier, so_far])
            if rule.within_a_sweep:
                history = [*posteriors, found]
                step = BeliefStep.last(history, [gain_vector(one, self.flat) for one in history])
                if bool(rule.check(step).converged):
                    return TraceSoFar(found, bins, decided=True)
        return TraceSoFar(found, count, decided=False)


def index_of(action: SweepAction, actions: Sequence[SweepAction]) -> int | None:
    """Return which of some actions is this one, as nearly as numbers travel; None: none."""
    if not actions:
        return None
    found = np.flatnonzero((np.abs(_rows(actions) - _rows([action])) < _ALIKE).all(axis=1))
    return int(found[0]) if len(found) else None


def _rows(actions: Sequence[SweepAction]) -> Float64Array:
    return np.array([[a.ring_m, a.indentation_m, a.speed_m_per_s, a.from_m, a.to_m] for a in actions])


def home_of(settings: TraceSettings, speed_m_per_s: float, scene: Scene | None = None) -> SweepTerms:
    """Return how training's sweeps were made.

    Args:
        settings: Their path, and the scene file of their indentation.
        speed_m_per_s: Their speed.
        scene: In place of the settings' scene.
    """
    found, _ = settings.of_rig(scene=scene)
    return SweepTerms(found.path.indentation_m, speed_m_per_s, settings.from_m, settings.to_m)
