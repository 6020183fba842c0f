"""Parameters by which a session reads its sweeps: which method of each task, and what is wrong with them."""

from __future__ import annotations

from palp_core.errors import PerceptionError
from palp_core.graph.messages.builtin import MethodUse
from palp_core.graph.node.node import Mistakes, ReadOnly
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.belief.trial_filter import NAIVE, require_likelihood, require_rings
from palp_core.palpation.perception.signal.wavelet import edge_cone
from palp_core.palpation.perception.strategy.trained_rings import PUBLISHED
from palp_core.palpation.session.method_choices import (
    AUTO,
    TRACE,
    DenoiseName,
    FeatureName,
    FilterName,
    LikelihoodName,
    Reading,
    StopName,
    TraceFilterName,
    chosen_for,
    given_by,
    names_of,
)
from palp_core.palpation.session.methods.used import used
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.palpation.session.trace_settings import TraceSettings
from palp_core.units import CountPositive, MillimetresNonNegative, RatioNonNegative

TASKS = ("denoise", "feature", "filter", "likelihood", "stop")
"""Tasks whose method is a parameter of the same name."""

TRACE_TASKS = ("denoise", "feature", "trace_filter", "stop")
"""Tasks of whole traces: the feature is what primitives and record are of."""


class ReadingParams(TraceSettings):
    """What the estimator reads sweeps by; see :class:`nodes.estimator.EstimatorParams`."""

    reading: ReadOnly[Reading] = "feature"
    wavelet: str = "db10"
    level: CountPositive = 5
    denoise: DenoiseName = "soft_universal"
    feature: FeatureName = "peak"
    likelihood: LikelihoodName = "normal"
    filter: FilterName = "naive"
    trace_filter: TraceFilterName = AUTO
    stop: StopName = "paper_guarded"
    stop_value: RatioNonNegative = 0.0
    max_probes: CountPositive = 15
    training: CountPositive = 25
    trained_mm: str = PUBLISHED
    height_sd_mm: MillimetresNonNegative = 0.1

    def asked(self) -> dict[str, str]:
        """Return the method that is asked for, or ``auto``, by task."""
        tasks = TRACE_TASKS if self.reading == TRACE else TASKS
        return {task: getattr(self, task) for task in tasks}


def resolve(params: ReadingParams) -> tuple[dict[str, str], list[str]]:
    """Return the method of each task, and of those left to the register a line that says why."""
    found = Mistakes()
    find_mistakes(params, found)
    for name, why in found.items():
        raise PerceptionError(f"{name}: {why}")
    return names_of(params.asked(), params)


def find_mistakes(params: ReadingParams, mistakes: Mistakes) -> None:
    """Add what is wrong with the methods and the files that parameters name, by parameter."""
    find_file_mistakes(params, mistakes)
    if mistakes:  # of files by which a method is chosen
        return
    with mistakes.of("wavelet"):
        edge_cone(params.level, params.wavelet)
    for task, name in params.asked().items():
        with mistakes.of(task):
            chosen_for({task: name}, params)
    if mistakes:
        return
    methods = names_of(params.asked(), params)[0]
    if params.reading == TRACE:
        with mistakes.of("bin_mm"):
            params.bins  # noqa: B018 - it refuses a width that does not fit
    else:
        with mistakes.of("likelihood"):
            require_likelihood(methods["filter"], methods["likelihood"])
        with mistakes.of("filter"):
            require_rings(methods["filter"], len(params.trained_mm.split(",")))
    with mistakes.of("stop"):
        stop_rule(methods["stop"], params.stop_value, max_probes=params.max_probes)


def uses_of(params: ReadingParams) -> list[MethodUse]:
    """Return which methods a sweep goes through, as the register weighs them with what is known here."""
    given, names = given_by(params), params.asked()
    scene = read_scene(params.scene) if params.scene else None
    if "filter" in names and names_of({"filter": params.filter}, params)[0]["filter"] != NAIVE:
        del names["likelihood"]  # what knows what stays has its own
    return [
        used(task, "" if name == AUTO else name, scene=scene, given=given) for task, name in names.items()
    ]
