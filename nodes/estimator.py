"""Infer the depth of the nodule from the torque of each sweep."""

from collections.abc import Callable

import numpy as np

from msgs.actuator import RingState
from msgs.estimation import Belief, Palpation, PrimitivesLearnt
from msgs.experiment import Trial
from msgs.stage import SweepStatus
from msgs.torque import TorqueBlock
from palp_core import Params, Pub, Sub, on
from palp_core.errors import MethodError, PerceptionError
from palp_core.graph.messages.builtin import MethodUse
from palp_core.methods import find
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief import bayes
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.primitives import Primitives, fit, quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import noise_of
from palp_core.palpation.perception.belief.stopping import Verdict, decide, stop_rule
from palp_core.palpation.perception.belief.trial_filter import (
    NAIVE,
    DepthCount,
    TrialFilter,
    TrialReading,
    require_likelihood,
)
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.strategy.trained_rings import untrained
from palp_core.palpation.session.filters import filter_of
from palp_core.palpation.session.method_choices import (
    AUTO,
    DenoiseName,
    FeatureName,
    FilterName,
    LikelihoodName,
    StopName,
    checks_of,
    given_by,
    names_of,
)
from palp_core.palpation.session.methods.teller import MethodTeller, MethodTellerState
from palp_core.palpation.session.methods.used import used
from palp_core.palpation.session.named_files import file_mistakes
from palp_core.units import (
    CountPositive,
    Float64Array,
    HertzPositive,
    MillimetresNonNegative,
    NewtonMillimetresPositive,
    RatioNonNegative,
    Seconds,
)

TASKS = ("denoise", "feature", "filter", "likelihood", "stop")
"""Tasks whose method is a parameter of the same name."""


class EstimatorParams(Params):
    """Set in the launch file; the names are those of the methods register.

    ``auto`` for ``denoise``, ``feature``, ``filter``, ``likelihood`` or ``stop`` leaves it to the register,
    which goes by scene, noise, ``training`` palpations a cell, ``max_probes`` and ``rate_hz``.
    ``stop_value`` is the stop rule's own number, 0 for its default. ``depths`` is the number of depths of a
    grid from the shallowest to the deepest trained; 0 decides among the trained ones. A ``filter`` that knows
    what stays reads it from ``noise``, a file of the plan ``repeatability``; empty: landings of
    ``ring_sd_mm``, heights of ``height_sd_mm``. ``scene`` is the scene file from whose mechanics it knows how
    a reading answers to the height.
    """

    wavelet: str = "db10"
    level: CountPositive = 5
    denoise: DenoiseName = "soft_universal"
    feature: FeatureName = "peak"
    likelihood: LikelihoodName = "normal"
    filter: FilterName = "naive"
    depths: DepthCount = 0
    noise: str = ""
    ring_sd_mm: MillimetresNonNegative = 0.17
    height_sd_mm: MillimetresNonNegative = 0.1
    scene: str = ""
    stop: StopName = "paper_guarded"
    stop_value: RatioNonNegative = 0.0
    max_probes: CountPositive = 15
    training: CountPositive = 25
    resolution_n_mm: NewtonMillimetresPositive = RESOLUTION_N_M * 1e3
    rate_hz: HertzPositive = 1000.0
    largest_gap_s: Seconds = 0.003


class EstimatorState(MethodTellerState):
    """What a replacement inherits: the sweep under way, what was learnt, and the belief of this trial."""

    trial: int = 0
    phase: str = ""
    label_known: bool = False
    depth_m: float = 0.0
    ring_m: float = 0.0
    ring_trial: int = 0
    ring_iteration: int = 0
    start_ns: int = 0
    rate_hz: float = 0.0
    blocks: list[bytes] = []
    received_count: int = 0
    expected_count: int = -1
    stream: SweepCut | None = None
    training: list[tuple[float, float, float]] = []
    primitives: dict[str, list[float]] = {}
    landed: bool = False
    probes: list[tuple[float, int, bool]] = []
    posteriors: list[list[float]] = []
    gains: list[list[float]] = []


def asked(params: EstimatorParams) -> dict[str, str]:
    """Return the method that is asked for, or ``auto``, by task."""
    return {task: getattr(params, task) for task in TASKS}


def checks(params: EstimatorParams) -> dict[str, Callable[[], object]]:
    """Return what tells whether methods are known and go together, by the parameter to change."""
    return {
        "wavelet": lambda: edge_cone(params.level, params.wavelet),
        **checks_of(asked(params), params),
    }


def together(params: EstimatorParams, used: dict[str, str]) -> dict[str, Callable[[], object]]:
    """Return what tells whether the methods that are used go together, by the parameter to change."""
    return {
        "likelihood": lambda: require_likelihood(used["filter"], used["likelihood"]),
        "stop": lambda: stop_rule(used["stop"], params.stop_value, max_probes=params.max_probes),
    }


def mistakes(params: EstimatorParams) -> dict[str, str]:
    """Return what is wrong with the methods and the files that parameters name, by parameter."""
    found = file_mistakes(params)
    if found:  # of files by which a method is chosen
        return found
    _note(checks(params), found)
    if not found:
        _note(together(params, names_of(asked(params), params)[0]), found)
    return found


def _note(those: dict[str, Callable[[], object]], found: dict[str, str]) -> None:
    for name, check in those.items():
        try:
            check()
        except (MethodError, PerceptionError) as error:
            found[name] = str(error)


def uses_of(params: EstimatorParams) -> list[MethodUse]:
    """Return which methods a sweep goes through, as the register weighs them with what is known here."""
    given, names = given_by(params), asked(params)
    scene = read_scene(params.scene) if params.scene else None
    if names_of({"filter": params.filter}, params)[0]["filter"] != NAIVE:
        del names["likelihood"]  # what knows what stays has its own
    return [
        used(task, "" if name == AUTO else name, scene=scene, given=given) for task, name in names.items()
    ]


class Estimator(MethodTeller):
    """De-noise a sweep, take its peak, learn from it in training, update the belief with it in estimation."""

    examine = staticmethod(mistakes)
    params: EstimatorParams
    state: EstimatorState
    trial = Sub(Trial)
    ring = Sub(RingState)
    sweep = Sub(SweepStatus)
    torque = Sub(TorqueBlock)
    belief = Pub(Belief)
    palpation = Pub(Palpation)
    primitives = Pub(PrimitivesLearnt)

    def on_configure(self) -> None:
        for check in checks(self.params).values():
            check()
        self.learnt: Primitives | None = None
        self.filters: tuple[EstimatorParams, TrialFilter] | None = None
        self.used: tuple[EstimatorParams, dict[str, str]] | None = None
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

    def on_parameters(self, params: Params) -> None:
        """Say with which methods the next sweep is read: it is the first that these are for."""
        if isinstance(params, EstimatorParams):
            self.tell_methods(uses_of(params))

    @on(trial)
    def note_trial(self, trial: Trial) -> None:
        state = self.state
        if state.phase == "training" and trial.phase == "estimation":
            self._learn()
        state.trial, state.phase = trial.trial, trial.phase
        state.label_known, state.depth_m = trial.label_known, trial.depth_m
        state.probes, state.posteriors, state.gains = [], [], []

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
            state.blocks, state.received_count, state.expected_count = [], 0, -1
            if state.stream is not None:
                state.stream.hold()
        elif status.status == "swept":
            if state.stream is not None and not status.sample_count:
                state.stream.bound(status.enter_ns, status.leave_ns)
                self._conclude_stream()
                return
            state.expected_count = status.sample_count
            self._conclude()
        elif status.status == "cancelled":
            state.blocks, state.received_count, state.expected_count = [], 0, -1
            if state.stream is not None:
                state.stream.release()

    @on(torque)
    def collect(self, block: TorqueBlock) -> None:
        state = self.state
        if not block.over_phantom:
            state.stream = state.stream or SweepCut()
            state.stream.add(block.start_ns, block.rate_hz, block.torque_n_m)
            self._conclude_stream()
            return
        if not state.blocks:
            state.start_ns, state.rate_hz = block.start_ns, block.rate_hz
        state.blocks.append(block.torque_n_m.tobytes())
        state.received_count += len(block.torque_n_m)
        self._conclude()

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
        torque_n_m = np.frombuffer(b"".join(state.blocks), dtype=np.float64)
        state.blocks, state.expected_count = [], -1
        self._palpated(torque_n_m)

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
        state, params, used = self.state, self.params, self._methods()
        clean = denoise(torque_n_m, wavelet=params.wavelet, level=params.level, rule=used["denoise"])
        peak = find("feature", used["feature"]).target(clean, edge=edge_cone(params.level, params.wavelet))
        if state.phase == "training" and state.label_known:
            state.training.append((state.depth_m, state.ring_m, peak.value_n_m))
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

    def _learn(self) -> None:
        """Fit the memory primitives to the training palpations."""
        readings = self.state.training
        depths_m = sorted({depth_m for depth_m, _, _ in readings})
        rings_m = sorted({ring_m for _, ring_m, _ in readings})
        learnt = fit(
            np.array([peak for _, _, peak in readings]),
            [depths_m.index(depth_m) for depth_m, _, _ in readings],
            [rings_m.index(ring_m) for _, ring_m, _ in readings],
            depths_m=depths_m,
            rings_m=rings_m,
            floor=quantisation_sd(self.params.resolution_n_mm * 1e-3),
        )
        self.learnt, self.filters = learnt, None
        self.state.primitives = {
            name: np.ravel(value).tolist() for name, value in learnt.to_json_dict().items()
        }
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
            used = self._methods()
            made = filter_of(
                memory,
                used["filter"],
                likelihood=used["likelihood"],
                depth_count=params.depths,
                feature=used["feature"],
                noise=noise_of(params.noise, params.ring_sd_mm * 1e-3, params.height_sd_mm * 1e-3),
                scene=read_scene(params.scene) if params.scene else None,
            )
            self.filters = (params, made)
        return self.filters[1]

    def _update(self, peak_n_m: float) -> None:
        """Bayes' rule, eq. (7), the gain of eq. (8), and the stop rule's verdict."""
        state, belief = self.state, self._filter()
        memory = belief.primitives
        where = np.flatnonzero(np.isclose(memory.rings_m, state.ring_m, atol=1e-9))
        if not len(where):
            self._drop(peak_n_m, memory)
            return
        setting = int(where[0])
        landed = state.landed or not state.probes or setting != state.probes[-1][1]
        state.landed = False
        state.probes.append((peak_n_m, setting, landed))
        posterior = belief.posterior([TrialReading(*probe) for probe in state.probes])
        gain = gain_vector(posterior, np.exp(bayes.flat_prior(len(memory.depths_m))))
        state.posteriors.append(posterior.tolist())
        state.gains.append(gain.tolist())
        verdict = decide(
            stop_rule(self._methods()["stop"], self.params.stop_value),
            [np.array(p) for p in state.posteriors],
            [np.array(g) for g in state.gains],
            max_probes=self.params.max_probes,
        )
        outlier = memory.is_outlier(peak_n_m, setting)
        self._publish_belief(peak_n_m, memory, posterior, gain, verdict, outlier=outlier)

    def _drop(self, peak_n_m: float, memory: Primitives) -> None:
        """End a trial whose ring stands where nothing was learnt: its reading says nothing of the depth."""
        state = self.state
        self.log.warning(
            "trial %d is dropped: %s", state.trial, untrained([state.ring_m], memory.rings_m.tolist())
        )
        flat = np.exp(bayes.flat_prior(len(memory.depths_m)))
        posterior = np.array(state.posteriors[-1]) if state.posteriors else flat
        verdict = Verdict("dropped", int(np.argmax(posterior)), len(state.probes), 0.0, gamma_defined=False)
        self._publish_belief(peak_n_m, memory, posterior, gain_vector(posterior, flat), verdict)

    def _publish_belief(
        self,
        peak_n_m: float,
        memory: Primitives,
        posterior: Float64Array,
        gain: Float64Array,
        verdict: Verdict,
        *,
        outlier: bool = False,
    ) -> None:
        state = self.state
        self.belief.publish(
            Belief(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.ring_iteration,
                depths_m=memory.depths_m,
                posterior=posterior,
                gain=gain,
                gamma=verdict.gamma,
                gamma_defined=verdict.gamma_defined,
                verdict=verdict.word,
                estimate_m=float(memory.depths_m[verdict.class_index]),
                confidence=float(posterior[verdict.class_index]),
                outlier=outlier,
                reading_n_m=peak_n_m,
            )
        )
