"""Infer the depth of the nodule from the torque of each sweep."""

import msgspec
import numpy as np

from msgs.actuator import RingState
from msgs.estimation import Belief, Outlook, Palpation, PrimitivesLearnt
from msgs.experiment import Trial
from msgs.stage import SweepStatus
from msgs.torque import TorqueBlock
from palp_core import Pub, ReadOnly, Sub, on
from palp_core.graph.messages.builtin import MethodUse
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.perception.signal.features import Peak
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.perception.strategy.trained_rings import untrained
from palp_core.palpation.session.methods.reporter import MethodReporter, MethodReporterState
from palp_core.palpation.session.reading import ReadingMemory, SweepTorque, reading_of
from palp_core.palpation.session.reading_params import ReadingParams, find_mistakes, resolve, uses_of
from palp_core.units import Float64Array, HertzPositive, MetresPerSecondPositive, Seconds


class EstimatorParams(ReadingParams):
    """Set in the launch file; the names are those of the methods register.

    ``auto`` for ``denoise``, ``feature``, ``filter``, ``trace_filter``, ``likelihood`` or ``stop`` leaves it
    to the register, which chooses by scene, noise, ``training``, ``max_probes`` and ``rate_hz``.
    ``stop_value`` is the stop rule's own number, 0 for its default. ``depths`` is the number of depths of a
    grid from the shallowest to the deepest trained; 0 decides among the trained ones. A ``filter`` that knows
    what stays reads it from ``noise``, a file of the plan ``repeatability``; empty: landings of
    ``ring_sd_mm``, heights of ``height_sd_mm``. ``scene`` is the scene file from whose mechanics
    it knows how a reading answers to the height.

    With the ``reading`` ``trace`` the belief follows the torque along the path in bins of ``bin_mm``, and is
    published after each as ``outlook``. Its ``trace_filter`` accounts for what differs between sweeps:
    landings as above, and by ``scene``'s mechanics what spreads as stated here (assumed), never as the
    simulated phantom does. ``run_in``: whether a sweep begins with a tip that sticks.
    """

    rate_hz: HertzPositive = 1000.0
    largest_gap_s: Seconds = 0.003
    sweep_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.020


class EstimatorState(MethodReporterState):
    """What a replacement inherits: training, the trial, the sweep under way and a stream of torque."""

    trial: int = 0
    number: int = 0
    phase: str = ""
    label_known: bool = False
    depth_m: float = 0.0
    ring_m: float = 0.0
    ring_iteration: int = 0
    landed: bool = False
    stream: SweepCut | None = None
    memory: ReadingMemory = msgspec.field(default_factory=ReadingMemory)


class Estimator(MethodReporter):
    """Read a sweep, learn from it in training, update the belief with it in estimation.

    Its reading is the peak of the de-noised torque, or the whole torque as it comes.
    """

    params: EstimatorParams
    state: EstimatorState
    trial = Sub(Trial)
    ring = Sub(RingState)
    sweep = Sub(SweepStatus)
    torque = Sub(TorqueBlock)
    belief = Pub(Belief)
    outlook = Pub(Outlook)
    palpation = Pub(Palpation)
    primitives = Pub(PrimitivesLearnt)

    @classmethod
    def find_mistakes(cls, params: EstimatorParams, mistakes: Mistakes) -> None:
        find_mistakes(params, mistakes)

    def on_configure(self) -> None:
        self._read_by(self.params)

    def on_parameters(self, params: EstimatorParams) -> None:  # type: ignore[override]
        """Read from here on by these parameters, and say by which methods."""
        self._read_by(params)
        self.publish_methods(uses_of(params))

    def _read_by(self, params: EstimatorParams) -> None:
        methods, why = resolve(params)
        for line in why:
            self.log.info("%s", line)
        self.reading = reading_of(params, methods)

    def uses(self) -> list[MethodUse]:
        return uses_of(self.params)

    def on_resume(self) -> None:
        self.reading.require(self.state.memory)
        super().on_resume()

    def on_restore(self) -> None:
        """Forget where the devices were: they start again, and the trial too, on another mounting."""
        state = self.state
        state.memory.sweep, state.memory.code = None, ""
        state.stream, state.landed = None, True

    @on(trial)
    def note_trial(self, trial: Trial) -> None:
        state = self.state
        if state.phase == "training" and trial.phase == "estimation":
            self._learn()
        state.trial, state.number, state.phase = trial.trial, trial.number, trial.phase
        state.label_known, state.depth_m = trial.label_known, trial.depth_m
        state.memory.begin_trial(trial.code)

    @on(ring)
    def note_ring(self, ring: RingState) -> None:
        if ring.rehome:
            self.state.landed = True
        else:
            self.state.ring_m, self.state.ring_iteration = ring.target_m, ring.iteration

    @on(sweep)
    def note_sweep(self, status: SweepStatus) -> None:
        state, sweep = self.state, self.state.memory.sweep
        if status.status == "sweeping":
            # a sweep that is read at its end takes its times when it is over, not those planned
            times_ns = (status.enter_ns, status.leave_ns) if self.reading.follows else (0, 0)
            self.reading.begin(state.memory, *times_ns)
            if state.stream is not None:
                state.stream.hold(*times_ns)
        elif sweep is not None and (
            status.status == "swept" or (status.status == "cancelled" and sweep.decided)
        ):
            sweep.expected, sweep.cancelled = status.sample_count, status.status == "cancelled"
            if state.stream is not None and not self.reading.follows:
                state.stream.bound(status.enter_ns, status.leave_ns)
            self._conclude()
        elif status.status == "cancelled":
            self._forget_sweep()

    def _forget_sweep(self) -> None:
        self.state.memory.sweep = None
        if self.state.stream is not None:
            self.state.stream.release()

    @on(torque)
    def collect(self, block: TorqueBlock) -> None:
        state = self.state
        if not block.over_phantom:
            state.stream = state.stream or SweepCut()
            state.stream.add(block.start_ns, block.rate_hz, block.torque_n_m)
        else:
            self._follow(block.start_ns, block.rate_hz, block.torque_n_m)
        self._conclude()

    def _follow_stream(self) -> None:
        """Take what has come of a sweep, on an even grid of time; at once if it is read at its end."""
        stream, sweep = self.state.stream, self.state.memory.sweep
        if stream is None or sweep is None or not stream.enter_ns:
            return
        if self.reading.follows or stream.complete:
            start_ns, torque_n_m = stream.since(self.params.rate_hz, sweep.count)
            self._follow(start_ns, self.params.rate_hz, torque_n_m)

    def _follow(self, start_ns: int, rate_hz: float, torque_n_m: Float64Array) -> None:
        """Add samples to the sweep under way, and publish what they make of the belief."""
        state, sweep = self.state, self.state.memory.sweep
        if sweep is None or not len(torque_n_m):
            return
        self.reading.add(state.memory, start_ns, rate_hz, torque_n_m)
        if state.phase != "estimation":
            return
        seen = self.reading.look(state.memory, state.ring_m, landed=state.landed)
        if seen is None:
            return
        depths_m, best = self.reading.depths_m(state.memory), int(np.argmax(seen.posterior))
        self.outlook.publish(
            Outlook(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.ring_iteration,
                depths_m=depths_m,
                posterior=seen.posterior,
                verdict="decided" if seen.decided else "continue",
                estimate_m=float(depths_m[best]),
                confidence=float(seen.posterior[best]),
                bin_count=seen.bins,
                sample_ns=sweep.start_ns + round((sweep.count - 1) * 1e9 / sweep.rate_hz),
            )
        )

    def _conclude(self) -> None:
        """Follow a stream; once the sweep is over and all its torque is here, make a palpation of it."""
        state, sweep = self.state, self.state.memory.sweep
        if sweep is None:
            return
        self._follow_stream()
        if not self.reading.is_complete(state.memory, state.stream):
            return
        if state.stream is not None and not sweep.expected:
            gap_s = state.stream.largest_gap_s(self.params.rate_hz)
            if gap_s > self.params.largest_gap_s:
                self.log.warning("torque gap_ms=%.0f within a sweep, bridged by a line", gap_s * 1e3)
        self.reading.end(state.memory)
        self._take(sweep, self.reading.feature(state.memory))
        self._forget_sweep()

    def _take(self, sweep: SweepTorque, peak: Peak) -> None:
        """Learn from a sweep that is over, or update the belief with it, and publish it."""
        state, memory = self.state, self.state.memory
        if state.phase == "training" and state.label_known:
            if not self.reading.teach(memory, state.depth_m, state.ring_m, peak.value_n_m):
                self.log.warning("a training sweep ended early; its trace is left out")
        elif state.phase == "estimation":
            self._update(peak.value_n_m)
        torque_n_m = sweep.torque_n_m
        self.palpation.publish(
            Palpation(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.ring_iteration,
                ring_m=state.ring_m,
                start_ns=sweep.start_ns,
                end_ns=sweep.start_ns + round((len(torque_n_m) - 1) * 1e9 / sweep.rate_hz),
                rate_hz=sweep.rate_hz,
                peak_n_m=peak.value_n_m,
                peak_index=peak.index,
                torque_n_m=torque_n_m,
            )
        )

    def _learn(self) -> None:
        learnt = self.reading.learn(self.state.memory)
        self.primitives.publish(
            PrimitivesLearnt(
                stamp_ns=self.now_ns(),
                depths_m=learnt.depths_m,
                rings_m=learnt.rings_m,
                mean_n_m=learnt.mean.ravel(),
                sd_n_m=learnt.sd.ravel(),
                count=learnt.count.ravel(),
                floor_n_m=learnt.floor,
            )
        )

    def _update(self, value_n_m: float) -> None:
        """Publish the belief after a sweep; one at a ring that was not trained ends the trial."""
        state, memory = self.state, self.state.memory
        found = self.reading.posterior(memory, state.ring_m, value_n_m, landed=state.landed)
        if found is None:
            wrong = untrained([state.ring_m], self.reading.rings_m(memory).tolist())
            self.log.warning("trial %d is dropped: %s", state.number, wrong)
        else:
            state.landed = False
        verdict = self.reading.verdict(memory, self.params.max_probes, dropped=found is None)
        posterior, depths_m = self.reading.last_posterior(memory), self.reading.depths_m(memory)
        self.belief.publish(
            Belief(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.ring_iteration,
                depths_m=depths_m,
                posterior=posterior,
                gain=self.reading.gain(posterior),
                gamma=verdict.gamma,
                gamma_defined=verdict.gamma_defined,
                verdict=verdict.word,
                estimate_m=float(depths_m[verdict.class_index]),
                confidence=float(posterior[verdict.class_index]),
                outlier=found is not None and not found.fits,
                reading_n_m=value_n_m,
            )
        )
