"""The rig: mechanics, perception, identification, sessions, devices and studies.

What a notebook needs of them is here, and loads on first use:

>>> from palp_core.palpation import Scene, run_scene
>>> run_scene(Scene()).choice.rung
'l2'

A session follows a plan, which yields what to do next and is sent what came of it. ``palp launch`` lets a rig
answer; without one a program does:

>>> import numpy as np
>>> from palp_core.palpation import ExperimentDesign, StepReply, experiment
>>> plan = experiment(ExperimentDesign(repeats=1, trials_per_phantom=1), np.random.default_rng(1))
>>> next(plan)
MountPhantom(phantom='A')
>>> [plan.send(StepReply("done")) for _ in range(3)][-1]
Palpate(trial=0, iteration=1, ring_given=True, ring_m=0.012)

:func:`read_result` and :func:`read_sessions` read what a session left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from palp_core.lazy_names import lazy_names

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
    from palp_core.palpation.session.plan import ExperimentDesign, StepReply, experiment
    from palp_core.palpation.session.recorded_sweeps import read_sessions
    from palp_core.palpation.session.result import SessionResult, read_result

__all__ = [
    "Bead",
    "ContactModel",
    "EmgSettings",
    "ExperimentDesign",
    "Phantom",
    "Primitives",
    "Probe",
    "Scene",
    "SessionResult",
    "StagePath",
    "StepReply",
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
    "experiment",
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

__getattr__, __dir__ = lazy_names(__name__)
