"""Which methods a sweep is read with, as a node's parameters ask for them, and what is wrong with those."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from palp_core.errors import MethodError, PerceptionError
from palp_core.graph.messages.builtin import MethodUse
from palp_core.methods import find
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.belief.trial_filter import NAIVE, require_likelihood, require_rings
from palp_core.palpation.perception.signal.features import Peak
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.session.method_choices import AUTO, TRACE, checks_of, given_by, names_of
from palp_core.palpation.session.methods.used import used
from palp_core.palpation.session.named_files import file_mistakes
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.units import Float64Array

TASKS = ("denoise", "feature", "filter", "likelihood", "stop")
"""Tasks whose method is a parameter of the same name."""

TRACE_TASKS = ("denoise", "feature", "trace_filter", "stop")
"""Tasks of a node that reads traces: the feature is still what its primitives and its record are of."""


def asked(params: Any) -> dict[str, str]:
    """Return the method that is asked for, or ``auto``, by task."""
    tasks = TRACE_TASKS if params.reading == TRACE else TASKS
    return {task: getattr(params, task) for task in tasks}


def checks(params: Any) -> dict[str, Callable[[], object]]:
    """Return what tells whether methods are known and go together, by the parameter to change."""
    return {
        "wavelet": lambda: edge_cone(params.level, params.wavelet),
        **checks_of(asked(params), params),
    }


def together(params: Any, used: dict[str, str]) -> dict[str, Callable[[], object]]:
    """Return what tells whether the methods that are used go together, by the parameter to change."""
    found: dict[str, Callable[[], object]] = {
        "stop": lambda: stop_rule(used["stop"], params.stop_value, max_probes=params.max_probes)
    }
    if params.reading == TRACE:
        return {**found, "bin_mm": lambda: TraceSettings.of(params).bins}
    return {
        "likelihood": lambda: require_likelihood(used["filter"], used["likelihood"]),
        "filter": lambda: require_rings(used["filter"], len(params.trained_mm.split(","))),
        **found,
    }


def mistakes(params: Any) -> dict[str, str]:
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


def peak_of(torque_n_m: Float64Array, params: Any, used: Mapping[str, str], *, whole: bool) -> Peak:
    """Return the feature of a sweep; of one that was decided before its end the largest torque so far."""
    if not whole:
        index = int(np.argmax(torque_n_m))
        return Peak(float(torque_n_m[index]), index)
    clean = denoise(torque_n_m, wavelet=params.wavelet, level=params.level, rule=used["denoise"])
    found: Peak = find("feature", used["feature"]).target(clean, edge=edge_cone(params.level, params.wavelet))
    return found


def uses_of(params: Any) -> list[MethodUse]:
    """Return which methods a sweep goes through, as the register weighs them with what is known here."""
    given, names = given_by(params), asked(params)
    scene = read_scene(params.scene) if params.scene else None
    if "filter" in names and names_of({"filter": params.filter}, params)[0]["filter"] != NAIVE:
        del names["likelihood"]  # what knows what stays has its own
    return [
        used(task, "" if name == AUTO else name, scene=scene, given=given) for task, name in names.items()
    ]
