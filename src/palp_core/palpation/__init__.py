"""The rig: mechanics, perception, identification, sessions, devices and studies.

What a notebook needs of them is here, and loads on first use:

>>> from palp_core.palpation import Scene, run_scene
>>> run_scene(Scene()).choice.rung
'l2'
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palp_core.palpation.identification.emg.files import read_emg
    from palp_core.palpation.identification.gel_fit import fit_gel
    from palp_core.palpation.mechanics import (
        Bead,
        ContactModel,
        Phantom,
        Probe,
        Scene,
        StagePath,
        Sweep,
        SweepTable,
        Tolerance,
        choose_rung,
        contact_model,
        equilibria,
        read_scene,
        run_scene,
        solve,
        sweep,
    )
    from palp_core.palpation.mechanics.equilibrium.dynamics import simulate
    from palp_core.palpation.perception.belief.primitives import Primitives
    from palp_core.palpation.perception.belief.stopping import decide, stop_rule
    from palp_core.palpation.perception.belief.trial_filter import TrialFilter, TrialReading, trial_filter
    from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
    from palp_core.palpation.perception.signal.features import contrast, peak
    from palp_core.palpation.perception.signal.wavelet import denoise
    from palp_core.palpation.session.recorded_sweeps import read_sessions
    from palp_core.palpation.session.result import SessionResult, read_result

__all__ = [
    "Bead",
    "ContactModel",
    "EmgSettings",
    "Phantom",
    "Primitives",
    "Probe",
    "Scene",
    "SessionResult",
    "StagePath",
    "Sweep",
    "SweepTable",
    "Tolerance",
    "TrialFilter",
    "TrialReading",
    "analyse",
    "choose_rung",
    "contact_model",
    "contrast",
    "decide",
    "denoise",
    "equilibria",
    "fit_gel",
    "peak",
    "read_emg",
    "read_result",
    "read_scene",
    "read_sessions",
    "run_scene",
    "simulate",
    "solve",
    "stop_rule",
    "sweep",
    "trial_filter",
]

_HOME = dict.fromkeys(__all__, "mechanics") | {
    "read_emg": "identification.emg.files",
    "fit_gel": "identification.gel_fit",
    "simulate": "mechanics.equilibrium.dynamics",
    "Primitives": "perception.belief.primitives",
    "decide": "perception.belief.stopping",
    "stop_rule": "perception.belief.stopping",
    "TrialFilter": "perception.belief.trial_filter",
    "TrialReading": "perception.belief.trial_filter",
    "trial_filter": "perception.belief.trial_filter",
    "EmgSettings": "perception.emg.analysis",
    "analyse": "perception.emg.analysis",
    "contrast": "perception.signal.features",
    "peak": "perception.signal.features",
    "denoise": "perception.signal.wavelet",
    "read_sessions": "session.recorded_sweeps",
    "SessionResult": "session.result",
    "read_result": "session.result",
}


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = globals()[name] = getattr(importlib.import_module(f"{__name__}.{home}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
