"""What a session reads off its sweeps: a feature of each, or its whole torque; live and in a re-analysis.

What was read is plain data in a :class:`ReadingMemory`, which a successor inherits. A belief is always that
of this data, whichever node makes it: what a reading remembers in addition saves time only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from palp_core.errors import PerceptionError
from palp_core.methods import find
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief import bayes
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.primitives import Primitives, fit_cells, quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import RigNoise, noise_of
from palp_core.palpation.perception.belief.stopping import BeliefStep, StopRule, Verdict, decide, stop_rule
from palp_core.palpation.perception.belief.trial_filter import TrialFilter, TrialReading, classes_of
from palp_core.palpation.perception.signal.features import Peak
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.trace import belief as trace_belief
from palp_core.palpation.perception.trace.bins import BinnedSweep, sample_times_ns
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.training import learn
from palp_core.palpation.session.filters import filter_of
from palp_core.palpation.session.reading_params import ReadingParams
from palp_core.units import Float64Array

_ALIKE_M = 1e-9
MISFIT_P = 0.01
"""Torques that fit no worse are more probable than this; others are reported not to fit."""


class SweepTorque(msgspec.Struct):
    """The sweep under way."""

    enter_ns: int = 0  # when the stage comes over the path, as reported when the sweep began; 0: not reported
    leave_ns: int = 0  # when it leaves it
    start_ns: int = 0  # time of the first sample
    rate_hz: float = 0.0
    blocks: list[bytes] = []  # the samples, N m, as bytes
    count: int = 0
    expected: int = -1  # how many the stage counted when it ended; -1: it has not
    cancelled: bool = False  # whether it ended before its path did, as it was decided
    bins: BinnedSweep = msgspec.field(default_factory=BinnedSweep)  # mean torques along the path
    seen: int = 0  # bins after which the belief was asked
    decided: int = 0  # bins after which the stop rule was passed; 0: it was not

    @property
    def torque_n_m(self) -> Float64Array:
        """All samples so far, shape (count,)."""
        return np.frombuffer(b"".join(self.blocks), dtype=np.float64)


class TrainingSweep(msgspec.Struct, frozen=True):
    """A sweep of training: its feature in N m, and the mean torque of its bins, where these are read."""

    depth_m: float
    ring_m: float
    mounting: int
    value_n_m: float
    bins_n_m: list[float]


class TestSweep(msgspec.Struct, frozen=True):
    """A sweep of a trial, likewise; ``landed``: the ring was moved, or re-homed, since the sweep before."""

    ring_m: float
    landed: bool
    value_n_m: float
    bins_n_m: list[float]


class ReadingMemory(msgspec.Struct):
    """What a successor inherits: training, this trial's sweeps and beliefs, the sweep under way.

    Training's mountings are numbered by the phantom's code: one that is put on again right after itself
    counts as the same mounting.
    """

    training: list[TrainingSweep] = []
    mounting: int = 0
    code: str = ""
    trial: list[TestSweep] = []
    posteriors: list[list[float]] = []
    gains: list[list[float]] = []
    sweep: SweepTorque | None = None

    def begin_trial(self, code: str = "") -> None:
        """Forget the trial before; a sweep that is still under way belongs to no trial."""
        if code and code != self.code:
            self.mounting, self.code = self.mounting + 1, code
        self.trial, self.posteriors, self.gains, self.sweep = [], [], [], None

    def is_repositioned(self, ring_m: float) -> bool:
        """Return whether the ring comes from elsewhere, by the trial's sweeps alone."""
        return not self.trial or abs(self.trial[-1].ring_m - ring_m) > _ALIKE_M


@dataclass(frozen=True)
class Outcome:
    """The belief after a sweep, or within it."""

    posterior: Float64Array  # of the classes, shape (m,)
    bins: int = 0  # how many of the sweep's bins it is from
    decided: bool = False  # whether the stop rule is passed within the sweep
    fits: bool = True  # whether any class explains what was read


class FeatureReading:
    """Sweeps read by one feature each, and the belief of their trial by a filter of task ``filter``."""

    follows = False

    def __init__(
        self,
        params: ReadingParams,
        methods: Mapping[str, str],
        noise: RigNoise | None = None,
        scene: Scene | None = None,
    ) -> None:
        """Read as parameters of the estimator say, with the method of each task."""
        self._params, self.methods, self._noise, self._scene = params, methods, noise, scene
        self._edge = edge_cone(params.level, params.wavelet)
        self._feature = find("feature", methods["feature"]).target
        self.rule: StopRule = stop_rule(methods["stop"], params.stop_value)
        self._learnt: Primitives | None = None

    def require(self, memory: ReadingMemory) -> None:
        """Refuse training that was read otherwise."""
        if memory.training and self.follows != any(sweep.bins_n_m for sweep in memory.training):
            raise PerceptionError("reading: training used another one (feature or trace); use that one")

    def begin(self, memory: ReadingMemory, enter_ns: int, leave_ns: int) -> None:
        """Begin a sweep over the path between two times."""
        memory.sweep = SweepTorque(enter_ns, leave_ns)

    def add(self, memory: ReadingMemory, start_ns: int, rate_hz: float, torque_n_m: Float64Array) -> None:
        """Take the next samples of the sweep under way, N m; ``start_ns`` is the time of the first."""
        sweep = memory.sweep
        if sweep is None:
            return
        if not sweep.count:
            sweep.start_ns, sweep.rate_hz = start_ns, rate_hz
        sweep.blocks.append(torque_n_m.tobytes())
        sweep.count += len(torque_n_m)

    def look(self, memory: ReadingMemory, ring_m: float, *, landed: bool) -> Outcome | None:
        """Return the belief within the sweep under way, where anything is new of it."""
        return None

    def is_complete(self, memory: ReadingMemory, stream: SweepCut | None) -> bool:
        """Return whether the sweep under way is over and all its torque is here.

        A ``stream`` is where torque is cut from, if the stage counts no samples.
        """
        sweep = memory.sweep
        if sweep is None or sweep.expected < 0:
            return False
        if stream is not None and not sweep.expected:
            return sweep.cancelled or stream.complete
        if sweep.count > sweep.expected and not self.follows:
            raise PerceptionError(
                f"{sweep.count} torque samples of a sweep of {sweep.expected} came; "
                "one sensor may feed 'torque', and only while the stage sweeps"
            )
        return sweep.count >= sweep.expected

    def end(self, memory: ReadingMemory) -> None:
        """End the sweep under way: all its samples are here."""

    def feature(self, memory: ReadingMemory) -> Peak:
        """Return the feature of the sweep under way, N m; the largest torque of one that was cancelled."""
        sweep = memory.sweep or SweepTorque()
        torque_n_m = sweep.torque_n_m
        if sweep.cancelled:
            index = int(np.argmax(torque_n_m))
            return Peak(float(torque_n_m[index]), index)
        wavelet, level = self._params.wavelet, self._params.level
        clean = denoise(torque_n_m, wavelet=wavelet, level=level, rule=self.methods["denoise"])
        found: Peak = self._feature(clean, edge=self._edge)
        return found

    def teach(self, memory: ReadingMemory, depth_m: float, ring_m: float, value_n_m: float) -> bool:
        """Keep the sweep under way as one of training; return whether all of it can be learnt from."""
        memory.training.append(TrainingSweep(depth_m, ring_m, memory.mounting, value_n_m, []))
        return True

    def posterior(
        self, memory: ReadingMemory, ring_m: float, value_n_m: float, *, landed: bool
    ) -> Outcome | None:
        """Keep the sweep under way as one of the trial, and return the belief after it.

        None where the ring is where nothing was learnt: then it is no reading of the trial.
        """
        setting = self.setting(memory, ring_m)
        if setting is None:
            return None
        moved = memory.is_repositioned(ring_m) or landed
        memory.trial.append(TestSweep(ring_m, moved, value_n_m, self._bins(memory)))
        found = self._outcome(memory, setting)
        memory.posteriors.append(found.posterior.tolist())
        memory.gains.append(self.gain(found.posterior).tolist())
        return found

    def verdict(self, memory: ReadingMemory, max_probes: int, *, dropped: bool = False) -> Verdict:
        """Return the stop rule's verdict after the trial's sweeps, or that the trial is dropped."""
        if dropped:
            best, count = int(np.argmax(self.last_posterior(memory))), len(memory.posteriors)
            return Verdict("dropped", best, count, 0.0, gamma_defined=False)
        posteriors, gains = ([np.array(row) for row in rows] for rows in (memory.posteriors, memory.gains))
        return decide(self.rule, posteriors, gains, max_probes=max_probes)

    def learn(self, memory: ReadingMemory) -> Primitives:
        """Fit the memory primitives to the features of training."""
        if not memory.training:
            raise PerceptionError(
                "a trial of estimation began before any training; there is nothing to compare with"
            )
        floor = quantisation_sd(self._params.resolution_n_mm * 1e-3)
        self.__dict__.pop("_filter", None)
        self._learnt = fit_cells([(one.depth_m, one.ring_m, one.value_n_m) for one in memory.training], floor)
        return self._learnt

    def primitives(self, memory: ReadingMemory) -> Primitives:
        """Return what was learnt of the features; from the memory if another has learnt it."""
        return self._learnt or self.learn(memory)

    def depths_m(self, memory: ReadingMemory) -> Float64Array:
        return classes_of(self.primitives(memory).depths_m.tolist(), self._params.depths)

    def rings_m(self, memory: ReadingMemory) -> Float64Array:
        return self.primitives(memory).rings_m

    def setting(self, memory: ReadingMemory, ring_m: float) -> int | None:
        """Return the index of a ring position among the trained ones; None: it is not."""
        found = np.flatnonzero(np.isclose(self.rings_m(memory), ring_m, atol=_ALIKE_M))
        return int(found[0]) if len(found) else None

    def last_posterior(self, memory: ReadingMemory) -> Float64Array:
        """Return the belief after the trial's last sweep, flat before the first, shape (m,)."""
        if memory.posteriors:
            return np.array(memory.posteriors[-1])
        return np.asarray(np.exp(bayes.flat_prior(len(self.depths_m(memory)))))

    @staticmethod
    def gain(posterior: Float64Array) -> Float64Array:
        """Return the gain of eq. (8) over the flat prior, nats."""
        return gain_vector(posterior, np.exp(bayes.flat_prior(len(posterior))))

    def _bins(self, memory: ReadingMemory) -> list[float]:
        return []

    def _outcome(self, memory: ReadingMemory, setting: int) -> Outcome:
        """Return the belief of the trial's readings: Bayes' rule, eq. (7), with what stays accounted for."""
        self.primitives(memory)
        found = self._filter
        settings = [self.setting(memory, sweep.ring_m) or 0 for sweep in memory.trial]
        probes = [
            TrialReading(sweep.value_n_m, of, sweep.landed)
            for sweep, of in zip(memory.trial, settings, strict=True)
        ]
        outlier = found.primitives.is_outlier(memory.trial[-1].value_n_m, setting)
        return Outcome(found.posterior(probes), fits=not outlier)

    @cached_property
    def _filter(self) -> TrialFilter:
        params, methods = self._params, self.methods
        if self._learnt is None:
            raise PerceptionError("nothing was learnt")
        return filter_of(
            self._learnt,
            methods["filter"],
            likelihood=methods["likelihood"],
            depth_count=params.depths,
            feature=methods["feature"],
            noise=self._noise or noise_of(params.noise, params.ring_sd_mm * 1e-3, params.height_sd_mm * 1e-3),
            scene=self._scene or (read_scene(params.scene) if params.scene else None),
        )


class TraceReading(FeatureReading):
    """Sweeps read by their whole torque, bin by bin as it comes; the feature is for primitives and record."""

    follows = True

    _model: tuple[int, TraceModel, Float64Array, Float64Array] | None = None
    _last: tuple[list[TestSweep], trace_belief.TraceBelief] | None = None

    def add(self, memory: ReadingMemory, start_ns: int, rate_hz: float, torque_n_m: Float64Array) -> None:
        """Take the next samples; the stage goes at constant speed between the sweep's two times."""
        sweep = memory.sweep
        if sweep is None or not len(torque_n_m):
            return
        first, path = sweep.count, self._params
        super().add(memory, start_ns, rate_hz, torque_n_m)
        if sweep.leave_ns <= sweep.enter_ns:
            raise PerceptionError(
                "a sweep over the path takes no time; the stage must report when it is there"
            )
        times_ns = sample_times_ns(sweep.start_ns, sweep.rate_hz, first, len(torque_n_m))
        done = (times_ns - sweep.enter_ns) / (sweep.leave_ns - sweep.enter_ns)
        sweep.bins.add(path.bins, path.from_m + (path.to_m - path.from_m) * done, torque_n_m)

    def look(self, memory: ReadingMemory, ring_m: float, *, landed: bool) -> Outcome | None:
        """Return the belief after the bins that are new, or after that which decides the trial.

        None where no bin is new, the sweep is decided, or the ring not trained. A rule that counts sweeps is
        asked when a sweep is over only.
        """
        sweep = memory.sweep
        if sweep is None or sweep.decided or len(sweep.bins.done) == sweep.seen:
            return None
        if self.setting(memory, ring_m) is None:
            return None
        moved, done = memory.is_repositioned(ring_m) or landed, sweep.bins.done
        within = self.rule.within_a_sweep
        found = Outcome(np.empty(0))
        for bins in range(sweep.seen + 1 if within else len(done), len(done) + 1):
            so_far = TestSweep(ring_m, moved, 0.0, done[:bins])
            posterior = self._classes(self._belief(memory, [*memory.trial, so_far]))
            found = Outcome(posterior, bins, within and self._is_decided(memory, posterior))
            if found.decided:
                sweep.decided = bins
                break
        sweep.seen = len(done)
        return found

    def end(self, memory: ReadingMemory) -> None:
        """End the sweep under way; the last bin is complete where the sweep ended in it."""
        sweep = memory.sweep
        if sweep is None or not sweep.count:
            raise PerceptionError("no torque came while the stage swept; is the sensor's stream running?")
        sweep.bins.finish(self._params.bins)

    def teach(self, memory: ReadingMemory, depth_m: float, ring_m: float, value_n_m: float) -> bool:
        """Keep the sweep under way; its trace teaches something if it reached the path's end."""
        done = self._bins(memory)
        memory.training.append(TrainingSweep(depth_m, ring_m, memory.mounting, value_n_m, done))
        return len(done) == self._params.bins.count

    def learn(self, memory: ReadingMemory) -> Primitives:
        """Learn both the features and the traces of training."""
        found = super().learn(memory)
        self._traces(memory)
        return found

    def depths_m(self, memory: ReadingMemory) -> Float64Array:
        return self._traces(memory)[1]

    def rings_m(self, memory: ReadingMemory) -> Float64Array:
        return self._traces(memory)[2]

    def _bins(self, memory: ReadingMemory) -> list[float]:
        sweep = memory.sweep
        return [] if sweep is None else sweep.bins.done[: sweep.decided or None]

    def _traces(self, memory: ReadingMemory) -> tuple[TraceModel, Float64Array, Float64Array]:
        """Return the model of sweeps, its depths and its rings, as training taught them."""
        count = len(memory.training)
        if self._model is None or self._model[0] != count:
            settings = self._params
            whole = [one for one in memory.training if len(one.bins_n_m) == settings.bins.count]
            if not whole:
                raise PerceptionError(
                    "no whole sweep of training is known by its trace; train with reading: trace"
                )
            trained = learn(
                np.array([one.bins_n_m for one in whole]),
                [one.depth_m for one in whole],
                [one.ring_m for one in whole],
                [one.mounting for one in whole],
                floor_n_m=settings.floor_n_m,
            )
            model = settings.model(trained, self._noise, self._scene, self.methods["trace_filter"])
            depths_m = classes_of(trained.depths_m.tolist(), settings.depths)
            self._model, self._last = (count, model, depths_m, trained.rings_m), None
        return self._model[1:]

    def _outcome(self, memory: ReadingMemory, setting: int) -> Outcome:
        found = self._belief(memory, memory.trial)
        fits = bool(trace_belief.fit_probability(found)[0] >= MISFIT_P)
        return Outcome(self._classes(found), fits=fits)

    def _classes(self, belief: trace_belief.TraceBelief) -> Float64Array:
        return np.asarray(trace_belief.classes(belief.log_density)[0])

    def _is_decided(self, memory: ReadingMemory, posterior: Float64Array) -> bool:
        history = [*(np.array(row) for row in memory.posteriors), posterior]
        step = BeliefStep.last(history, [self.gain(one) for one in history])
        return bool(self.rule.check(step).converged)

    def _belief(self, memory: ReadingMemory, sweeps: Sequence[TestSweep]) -> trace_belief.TraceBelief:
        """Return the belief of the bins of a trial's sweeps; it goes on from the last where these do."""
        model = self._traces(memory)[0]
        found, done = trace_belief.start(model), []
        if self._last is not None and _goes_on(sweeps, self._last[0]):
            found, done = self._last[1], [len(one.bins_n_m) for one in self._last[0]]
        for number, sweep in enumerate(sweeps):
            known = done[number] if number < len(done) else 0
            if number >= len(done):
                setting = self.setting(memory, sweep.ring_m)
                if setting is None:
                    raise PerceptionError(f"nothing was learnt of a ring at {sweep.ring_m * 1e3:g} mm")
                found = trace_belief.begin_sweep(found, setting, landed=sweep.landed)
            if rest := sweep.bins_n_m[known:]:
                found = trace_belief.observe(model, found, rest)
        self._last = (list(sweeps), found)
        return found


def _goes_on(sweeps: Sequence[TestSweep], before: Sequence[TestSweep]) -> bool:
    """Return whether sweeps are those before, of which the last may have got further, and others."""
    if not before or len(sweeps) < len(before):
        return False
    last, same = before[-1], sweeps[len(before) - 1]
    return (
        list(sweeps[: len(before) - 1]) == list(before[:-1])
        and (same.ring_m, same.landed) == (last.ring_m, last.landed)
        and same.bins_n_m[: len(last.bins_n_m)] == last.bins_n_m
    )


def reading_of(
    params: ReadingParams,
    methods: Mapping[str, str],
    noise: RigNoise | None = None,
    scene: Scene | None = None,
) -> FeatureReading:
    """Return the reading that parameters of the estimator ask for: ``feature`` or ``trace``."""
    kind = TraceReading if params.reading == "trace" else FeatureReading
    return kind(params, methods, noise, scene)
