"""Which methods the estimator uses, and which choices are refused before anything starts."""

from __future__ import annotations

from collections.abc import Callable

from nodes.named_files import file_mistakes
from palp_core import Params
from palp_core.errors import MethodError, PerceptionError
from palp_core.palpation.methods import find
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.belief.trial_filter import require_likelihood
from palp_core.palpation.perception.signal.wavelet import edge_cone
from palp_core.units import (
    Count,
    CountPositive,
    HertzPositive,
    MillimetresNonNegative,
    NewtonMillimetresPositive,
    RatioNonNegative,
    Seconds,
)


class EstimatorParams(Params):
    """Set in the launch file; the names are those of the methods register.

    ``stop_value`` is the stop rule's own number, 0 for its default. ``depths`` is the number of depths of a
    grid from the shallowest to the deepest trained; 0 decides among the trained ones. A ``filter`` that knows
    what stays reads it from ``noise``, a file of the plan ``repeatability``; empty: landings of
    ``ring_sd_mm``, heights of ``height_sd_mm``. ``scene`` is the scene file from whose mechanics it knows how
    a reading answers to the height.
    """

    wavelet: str = "db10"
    level: CountPositive = 5
    denoise: str = "soft_universal"
    feature: str = "peak"
    likelihood: str = "normal"
    filter: str = "naive"
    depths: Count = 0
    noise: str = ""
    ring_sd_mm: MillimetresNonNegative = 0.17
    height_sd_mm: MillimetresNonNegative = 0.1
    scene: str = ""
    stop: str = "paper_guarded"
    stop_value: RatioNonNegative = 0.0
    max_probes: CountPositive = 15
    resolution_n_mm: NewtonMillimetresPositive = 1.0 / 64.0
    rate_hz: HertzPositive = 1000.0
    largest_gap_s: Seconds = 0.003


def checks(params: EstimatorParams) -> dict[str, Callable[[], object]]:
    """Return what tells whether methods are known and go together, by the parameter to change."""
    return {
        "wavelet": lambda: edge_cone(params.level, params.wavelet),
        "denoise": lambda: find("denoise", params.denoise),
        "feature": lambda: find("feature", params.feature),
        "likelihood": lambda: require_likelihood(params.filter, params.likelihood),
        "stop": lambda: stop_rule(params.stop, params.stop_value, max_probes=params.max_probes),
    }


def mistakes(params: EstimatorParams) -> dict[str, str]:
    """Return what is wrong with the methods and the files that parameters name, by parameter."""
    found = file_mistakes(params)
    for name, check in checks(params).items():
        try:
            check()
        except (MethodError, PerceptionError) as error:
            found[name] = str(error)
    return found
