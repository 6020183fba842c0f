"""Probe where the next reading is expected to give most information on the depth."""

import numpy as np

from nodes.policy import PolicyNode, PolicyParams, RingMillimetres
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.rig_noise import independent_model, noise_of
from palp_core.palpation.perception.belief.trial_filter import DepthCount, TrialReading, belief_after
from palp_core.palpation.perception.strategy import policies
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.palpation.session.filters import filter_of
from palp_core.palpation.session.method_choices import FeatureName, FilterName, names_of
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.units import CountPositive, Float64Array, MillimetresNonNegative


class InformationParams(PolicyParams):
    """Set in the launch file.

    ``knows`` is what the policy knows to stay, a filter's name: ``naive`` takes all readings for independent,
    ``latent`` knows that a landing stays until the ring moves, and the height for the trial.
    ``noise``, ``ring_sd_mm``, ``height_sd_mm``, ``scene``, ``feature``, ``depths`` and ``training`` are as of
    the estimator, ``auto`` too; with equal ones it has the estimator's own belief. ``per_second`` weighs bits
    by the time of move and sweep. ``start_mm`` is where it probes as long as nothing was learnt (assumed: the
    stiffest).
    """

    knows: FilterName = "latent"
    noise: str = ""
    ring_sd_mm: MillimetresNonNegative = 0.17
    height_sd_mm: MillimetresNonNegative = 0.1
    scene: str = ""
    feature: FeatureName = "peak"
    training: CountPositive = 25
    depths: DepthCount = 0
    per_second: bool = False
    start_mm: RingMillimetres = 16.0


class Information(PolicyNode):
    """Greedy, one probe ahead, with what training left and what stays in the trial."""

    params: InformationParams

    @classmethod
    def find_mistakes(cls, params: InformationParams, mistakes: Mistakes) -> None:
        find_file_mistakes(params, mistakes)
        for name, task in (("feature", "feature"), ("knows", "filter")):
            if not mistakes:
                with mistakes.of(name):
                    names_of({task: getattr(params, name)}, params)
        super().find_mistakes(params, mistakes)

    def on_configure(self) -> None:
        self.made: tuple[InformationParams, dict[str, list[float]], latent.OffsetModel] | None = None
        super().on_configure()

    def choose(self) -> policies.StiffnessPolicy:
        state = self.state
        if not state.primitives:
            return policies.FixedRing(round(self.params.start_mm * 1e-3, 9))
        return InformationGainLatent(
            self._model(), tuple(state.primitives["rings_m"]), per_second=self.params.per_second
        )

    def policy_for_next_probe(self) -> policies.StiffnessPolicy:
        return self.choose()

    def belief_from_posterior(self, posterior: Float64Array) -> latent.Belief:
        """Return the classes' probabilities as given, and of the offsets what the trial's readings imply."""
        state = self.state
        if not state.primitives:
            return super().belief_from_posterior(posterior)
        rings_m = np.array(state.primitives["rings_m"])
        levels = [int(np.argmin(np.abs(rings_m - ring_m))) for ring_m in state.tried_m]
        probes = map(TrialReading, state.readings_n_m, levels, state.landed)
        return belief_after(self._model(), list(probes)).with_classes(posterior)

    def _model(self) -> latent.OffsetModel:
        """Return how readings spread and what stays; made again where parameters or primitives are new."""
        kept, params = self.state.primitives, self.params
        if self.made is None or self.made[0] != params or self.made[1] != kept:
            names = (("mean_n_m", "mean"), ("sd_n_m", "sd"), ("floor_n_m", "floor"))
            learnt = Primitives.from_rows({**kept, **{name: kept[wire] for wire, name in names}})
            used, _ = names_of({"feature": params.feature, "filter": params.knows}, params)
            made = filter_of(
                learnt,
                used["filter"],
                depth_count=params.depths,
                feature=used["feature"],
                noise=noise_of(params.noise, params.ring_sd_mm * 1e-3, params.height_sd_mm * 1e-3),
                scene=read_scene(params.scene) if params.scene else None,
            )
            self.made = (params, kept, made.model or independent_model(made.primitives))
        return self.made[2]
