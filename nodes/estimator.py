"""Infer the depth of the nodule from the torque of each sweep."""

import numpy as np

from msgs.actuator import RingState
from msgs.estimation import Belief, Outlook, Palpation, PrimitivesLearnt
from msgs.experiment import Trial
from msgs.stage import SweepStatus
from msgs.torque import TorqueBlock
from nodes.estimator_params import EstimatorParams, EstimatorState
from palp_core import DiagnosticStatus, Params, Pub, Qos, Sub, on
from palp_core.graph.messages.builtin import MethodUse
from palp_core.palpation.perception.belief import bayes
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.primitives import Primitives, fit_cells, quantisation_sd
from palp_core.palpation.perception.belief.stopping import StopRule, Verdict, decide, stop_rule
from palp_core.palpation.perception.belief.trial_filter import TrialFilter, TrialReading
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.perception.strategy.trained_rings import untrained
from palp_core.palpation.session.filters import filter_by
from palp_core.palpation.session.method_choices import TRACE, names_of
from palp_core.palpation.session.methods.estimating import (
    asked,
    checks,
    mistakes,
    peak_of,
    together,
    uses_of,
)
from palp_core.palpation.session.methods.teller import MethodTeller
from palp_core.palpation.session.trace.reader import SweepUnderWay
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.palpation.session.trace.watch import TraceWatch
from palp_core.palpation.session.unlike_training import ADVICE, by_readings, unlike_training
from palp_core.units import Float64Array


class Estimator(MethodTeller):
    """Read a sweep, learn from it in training, update the belief with it in estimation.

    Its reading is the peak of the de-noised torque, or the whole torque as it comes.
    """

    examine = staticmethod(mistakes)
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
    diagnostics = Pub(DiagnosticStatus, qos=Qos(durability="transient_local", depth=1))

    def on_configure(self) -> None:
        for check in checks(self.params).values():
            check()
        self.learnt: Primitives | None = None
        self.filters: tuple[EstimatorParams, TrialFilter] | None = None
        self.used: tuple[EstimatorParams, dict[str, str]] | None = None
        self.watch: tuple[EstimatorParams, TraceWatch] | None = None
        self.traces = self.params.reading == TRACE
        for check in together(self.params, self._methods()).values():
            check()

    def _methods(self) -> dict[str, str]:
        """Return the method of each task, chosen once for these parameters."""
        if self.used is None or self.used[0] != self.params:
            found, why = names_of(asked(self.params), self.params)
            for line in why:
                self.log.info("%s", line)
            self.used = (self.params, found)
        return self.used[1]

    def uses(self) -> list[MethodUse]:
        return uses_of(self.params)

    def on_resume(self) -> None:
        if self.state.training:
            self.state.trace.require(traces=self.traces)
        if self.state.session.told:
            self._diagnose(self.state.session.told)
        super().on_resume()

    def on_restore(self) -> None:
        """Forget where the devices were: they start again, and the trial too, on another mounting."""
        self._forget_sweep()
        self.state.stream, self.state.landed, self.state.trace.code = None, True, ""

    def on_parameters(self, params: Params) -> None:
        """Say with which methods the next sweep is read: it is the first that these are for."""
        self.tell_methods(uses_of(params))

    @on(trial)
    def note_trial(self, trial: Trial) -> None:
        state = self.state
        if state.phase == "training" and trial.phase == "estimation":
            self._learn()
        state.trial, state.number, state.phase = trial.trial, trial.number, trial.phase
        state.label_known, state.depth_m = trial.label_known, trial.depth_m
        state.probes, state.posteriors, state.gains = [], [], []
        state.trace.begin_trial(trial.code)

    @on(ring)
    def note_ring(self, ring: RingState) -> None:
        if ring.rehome:
            self.state.landed = True
        else:
            self.state.ring_m = ring.target_m
            self.state.ring_trial, self.state.ring_iteration = ring.trial, ring.iteration

    @on(sweep)
    def note_sweep(self, status: SweepStatus) -> None:
        state = self.state
        if status.status == "sweeping":
            self._begin(status)
        elif self.traces:
            self._end_traced(status)
        elif status.status == "swept" and state.stream is not None and not status.sample_count:
            state.stream.bound(status.enter_ns, status.leave_ns)
            self._conclude_stream()
        elif status.status == "swept":
            state.expected_count = status.sample_count
            self._conclude()
        elif status.status == "cancelled":
            self._forget_sweep()

    def _begin(self, status: SweepStatus) -> None:
        state = self.state
        self._forget_sweep()
        told = (status.enter_ns, status.leave_ns) if self.traces else (0, 0)
        state.trace.sweep = SweepUnderWay(*told) if self.traces else None
        if state.stream is not None:
            state.stream.hold(*told)

    def _forget_sweep(self) -> None:
        state = self.state
        state.blocks, state.received_count, state.expected_count = [], 0, -1
        state.trace.sweep = None
        if state.stream is not None:
            state.stream.release()

    @on(torque)
    def collect(self, block: TorqueBlock) -> None:
        state = self.state
        if not block.over_phantom:
            state.stream = state.stream or SweepCut()
            state.stream.add(block.start_ns, block.rate_hz, block.torque_n_m)
            if self.traces:
                self._follow_stream(state.stream)
            else:
                self._conclude_stream()
        elif not self.traces:
            self._gather(block.start_ns, block.rate_hz, block.torque_n_m)
            self._conclude()
        elif state.trace.sweep is not None:
            self._follow(block.start_ns, block.rate_hz, block.torque_n_m)

    def _gather(self, start_ns: int, rate_hz: float, torque_n_m: Float64Array) -> None:
        state = self.state
        if not state.blocks:
            state.start_ns, state.rate_hz = start_ns, rate_hz
        state.blocks.append(torque_n_m.tobytes())
        state.received_count += len(torque_n_m)

    def _conclude(self) -> None:
        """Once the sweep is over and all its samples are here, make a palpation of it."""
        state = self.state
        if state.expected_count < 0 or state.received_count < state.expected_count:
            return
        if state.received_count > state.expected_count:
            raise ValueError(
                f"{state.received_count} torque samples of a sweep of {state.expected_count} came; "
                "one sensor may feed 'torque', and only while the stage sweeps"
            )
        self._palpated(self._gathered())

    def _gathered(self) -> Float64Array:
        blocks, self.state.blocks, self.state.expected_count = self.state.blocks, [], -1
        return np.frombuffer(b"".join(blocks), dtype=np.float64)

    def _conclude_stream(self) -> None:
        """Cut a sweep out of a stream once the stream has passed its end."""
        state = self.state
        if state.stream is None or not state.stream.complete:
            return
        cut = state.stream.cut(self.params.rate_hz)
        state.stream.release()
        state.start_ns, state.rate_hz = cut.start_ns, cut.rate_hz
        if cut.largest_gap_s > self.params.largest_gap_s:
            self.log.warning("a gap of %.0f ms in the torque of a sweep is bridged", cut.largest_gap_s * 1e3)
        self._palpated(cut.torque_n_m)

    def _palpated(self, torque_n_m: Float64Array) -> None:
        """Take the peak of a sweep; learn from it or update the belief with it."""
        state, sweep = self.state, self.state.trace.sweep
        whole = sweep is None or sweep.whole
        peak = peak_of(torque_n_m, self.params, self._methods(), whole=whole)
        if state.phase == "training" and state.label_known:
            state.training.append((state.depth_m, state.ring_m, peak.value_n_m))
            if self.traces and not state.trace.teach(state.depth_m, state.ring_m, self._watch().settings):
                self.log.warning("a sweep of training ended before the path did; its trace teaches nothing")
        elif state.phase == "estimation" and self.traces:
            self._update_traced(peak.value_n_m)
        elif state.phase == "estimation":
            self._update(peak.value_n_m)
        self.palpation.publish(
            Palpation(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.ring_iteration,
                ring_m=state.ring_m,
                start_ns=state.start_ns,
                end_ns=state.start_ns + round((len(torque_n_m) - 1) * 1e9 / state.rate_hz),
                rate_hz=state.rate_hz,
                peak_n_m=peak.value_n_m,
                peak_index=peak.index,
                torque_n_m=torque_n_m,
            )
        )

    def _watch(self) -> TraceWatch:
        if self.watch is None or self.watch[0] != self.params:
            settings = TraceSettings.of(self.params, self._methods())
            self.watch = (self.params, TraceWatch(settings))
        return self.watch[1]

    def _follow_stream(self, stream: SweepCut) -> None:
        """Follow a sweep on an even grid of time, as far as a stream of torque has come."""
        if self.state.trace.sweep is not None and stream.held and stream.enter_ns:
            start_ns, torque_n_m = stream.since(self.params.rate_hz, self.state.received_count)
            self._follow(start_ns, self.params.rate_hz, torque_n_m)

    def _follow(self, start_ns: int, rate_hz: float, torque_n_m: Float64Array) -> None:
        """Add samples to the sweep under way, and say what they make of the belief."""
        state, first = self.state, self.state.received_count
        if len(torque_n_m):
            self._gather(start_ns, rate_hz, torque_n_m)
            self._watch().add(state.trace, state.start_ns, state.rate_hz, first, torque_n_m)
            if state.phase == "estimation":
                self._look()
        self._conclude_traced()

    def _look(self) -> None:
        state, trace = self.state, self.state.trace
        seen = self._watch().look(trace, state.ring_m, self._rule(), state.posteriors, landed=state.landed)
        if seen is None:
            return
        depths_m, best = self._depths_m(), int(np.argmax(seen.posterior))
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
                sample_ns=state.start_ns + round((state.received_count - 1) * 1e9 / state.rate_hz),
            )
        )

    def _end_traced(self, status: SweepStatus) -> None:
        """End a sweep that was swept, or that was cancelled once it was decided; forget any other."""
        sweep = self.state.trace.sweep
        if sweep is None or status.status not in ("swept", "cancelled"):
            return
        if status.status == "cancelled" and not sweep.decided:
            self._forget_sweep()
            return
        sweep.over, sweep.whole = True, status.status == "swept"
        self.state.expected_count = status.sample_count
        self._conclude_traced()

    def _conclude_traced(self) -> None:
        """Once the sweep is over and its torque is here, make a palpation of it."""
        state, sweep, stream = self.state, self.state.trace.sweep, self.state.stream
        if sweep is None or not sweep.all_here(state.received_count, state.expected_count, stream):
            return
        if stream is not None:
            stream.release()
        if not state.received_count:
            raise ValueError("no torque came while the stage swept; is the sensor's stream running?")
        if sweep.whole:
            sweep.finish(self._watch().settings)
        self._palpated(self._gathered())
        state.trace.sweep = None

    def _update_traced(self, peak_n_m: float) -> None:
        """Close a sweep of the trial: its bins up to the decision, or all, are the reading."""
        state, watch = self.state, self._watch()
        found = watch.close(state.trace, state.ring_m, landed=state.landed)
        if found is None:
            self._drop(peak_n_m, watch.reader(state.trace).rings_m)
            return
        state.landed, (posterior, fits) = False, found
        self._judge(peak_n_m, posterior, outlier=not fits)

    def _learn(self) -> None:
        """Fit the memory primitives to the training palpations."""
        learnt = fit_cells(self.state.training, quantisation_sd(self.params.resolution_n_mm * 1e-3))
        self.learnt, self.filters = learnt, None
        if self.traces:
            self._watch().reader(self.state.trace)  # now, and not when the first sweep is to be followed
        self.state.primitives = {n: np.ravel(v).tolist() for n, v in learnt.to_json_dict().items()}
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

    def _memory(self) -> Primitives:
        """Return the primitives; from the state if this node has inherited them."""
        if self.learnt is None:
            kept = self.state.primitives
            if not kept:
                raise ValueError(
                    "a trial of estimation began before any training; there is nothing to compare with"
                )
            self.learnt = Primitives.from_rows(kept)
        return self.learnt

    def _filter(self) -> TrialFilter:
        """Return the filter that the parameters describe over what was learnt."""
        memory, params = self._memory(), self.params
        if self.filters is None or self.filters[0] != params:
            self.filters = (params, filter_by(params, memory, self._methods()))
        return self.filters[1]

    def _update(self, peak_n_m: float) -> None:
        """Bayes' rule, eq. (7), the gain of eq. (8), and the stop rule's verdict."""
        state, belief = self.state, self._filter()
        memory = belief.primitives
        where = np.flatnonzero(np.isclose(memory.rings_m, state.ring_m, atol=1e-9))
        if not len(where):
            self._drop(peak_n_m, memory.rings_m)
            return
        setting = int(where[0])
        landed = state.landed or not state.probes or setting != state.probes[-1][1]
        state.landed = False
        state.probes.append((peak_n_m, setting, landed))
        probes = [TrialReading(*probe) for probe in state.probes]
        posterior = belief.posterior(probes)
        self._judge(peak_n_m, posterior, outlier=memory.is_outlier(peak_n_m, setting))

    def _depths_m(self) -> Float64Array:
        """Return the depths that the belief is about."""
        if self.traces:
            return self._watch().reader(self.state.trace).depths_m
        return self._filter().primitives.depths_m

    def _rule(self) -> StopRule:
        return stop_rule(self._methods()["stop"], self.params.stop_value)

    def _judge(self, reading_n_m: float, posterior: Float64Array, *, outlier: bool) -> None:
        """Publish the belief after a palpation, with its gain and the stop rule's verdict."""
        state = self.state
        state.posteriors.append(posterior.tolist())
        state.gains.append(_gain(posterior).tolist())
        verdict = decide(
            self._rule(),
            [np.array(p) for p in state.posteriors],
            [np.array(g) for g in state.gains],
            max_probes=self.params.max_probes,
        )
        self.belief.publish(self._belief(reading_n_m, posterior, verdict, outlier=outlier))
        if verdict.word in ("decided", "undecided"):
            self._compare(verdict.class_index)

    def _compare(self, of: int) -> None:
        """Hold the session, with the trial that is over, against training; say once if it does not fit."""
        state, one = self.state, None
        if self.traces:
            one = self._watch().against_training(state.trace)
        elif not self.params.depths:
            one = by_readings(self._memory(), state.probes, of, self.params.ring_sd_mm * 1e-3)
        if words := unlike_training(state.session, one, state.trace.code):
            self.log.warning("%s; %s", words, ADVICE)
            self._diagnose(words)

    def _diagnose(self, words: str) -> None:
        said = DiagnosticStatus(stamp_ns=self.now_ns(), level="warn", text=words, advice=ADVICE)
        self.diagnostics.publish(said)

    def _drop(self, reading_n_m: float, rings_m: Float64Array) -> None:
        """End a trial whose ring stands where nothing was learnt: its reading says nothing of the depth."""
        state = self.state
        self.log.warning("trial %d is dropped: %s", state.number, untrained([state.ring_m], rings_m.tolist()))
        flat = np.exp(bayes.flat_prior(len(self._depths_m())))
        posterior = np.array(state.posteriors[-1]) if state.posteriors else flat
        best, count = int(np.argmax(posterior)), len(state.posteriors)
        verdict = Verdict("dropped", best, count, 0.0, gamma_defined=False)
        self.belief.publish(self._belief(reading_n_m, posterior, verdict))

    def _belief(
        self, reading_n_m: float, posterior: Float64Array, verdict: Verdict, *, outlier: bool = False
    ) -> Belief:
        state, depths_m = self.state, self._depths_m()
        return Belief(
            stamp_ns=self.now_ns(),
            trial=state.trial,
            iteration=state.ring_iteration,
            depths_m=depths_m,
            posterior=posterior,
            gain=_gain(posterior),
            gamma=verdict.gamma,
            gamma_defined=verdict.gamma_defined,
            verdict=verdict.word,
            estimate_m=float(depths_m[verdict.class_index]),
            confidence=float(posterior[verdict.class_index]),
            outlier=outlier,
            reading_n_m=reading_n_m,
        )


def _gain(posterior: Float64Array) -> Float64Array:
    """Return the gain of eq. (8) over the flat prior, nats."""
    return gain_vector(posterior, np.exp(bayes.flat_prior(len(posterior))))
