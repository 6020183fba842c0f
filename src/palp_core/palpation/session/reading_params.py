"""Parameters by which a session reads its sweeps: which method of each task, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from palp_core.errors import MethodError, PerceptionError
from palp_core.graph.messages.builtin import MethodUse
from palp_core.graph.node.node import ReadOnly
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
    checks_of,
    given_by,
    names_of,
)
from palp_core.palpation.session.methods.used import used
from palp_core.palpation.session.named_files import file_mistakes
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
    for name, why in mistakes(params).items():
        raise PerceptionError(f"{name}: {why}")
    return names_of(params.asked(), params)


def mistakes(params: ReadingParams) -> dict[str, str]:
    """Return what is wrong with the methods and the files that parameters name, by parameter."""
    found = file_mistakes(params)
    if found:  # of files by which a method is chosen
        return found
    wavelet = {"wavelet": lambda: edge_cone(params.level, params.wavelet)}
    found = _failed({**wavelet, **checks_of(params.asked(), params)})
    return found or _failed(_contradictions(params, names_of(params.asked(), params)[0]))


def _contradictions(params: ReadingParams, methods: Mapping[str, str]) -> dict[str, Callable[[], object]]:
    """Return what raises where methods do not go together, by the parameter to change."""
    found: dict[str, Callable[[], object]] = {
        "stop": lambda: stop_rule(methods["stop"], params.stop_value, max_probes=params.max_probes)
    }
    if params.reading == TRACE:
        return {**found, "bin_mm": lambda: params.bins}
    return {
        "likelihood": lambda: require_likelihood(methods["filter"], methods["likelihood"]),
        "filter": lambda: require_rings(methods["filter"], len(params.trained_mm.split(","))),
        **found,
    }


def _failed(checks: Mapping[str, Callable[[], object]]) -> dict[str, str]:
    found = {}
    for name, check in checks.items():
        try:
            check()
        except (MethodError, PerceptionError) as error:
            found[name] = str(error)
    return found


def uses_of(params: ReadingParams) -> list[MethodUse]:
    """Return which methods a sweep goes through, as the register weighs them with what is known here."""
    given, names = given_by(params), params.asked()
    scene = read_scene(params.scene) if params.scene else None
    if "filter" in names and names_of({"filter": params.filter}, params)[0]["filter"] != NAIVE:
        del names["likelihood"]  # what knows what stays has its own
    return [
        used(task, "" if name == AUTO else name, scene=scene, given=given) for task, name in names.items()
    ]
