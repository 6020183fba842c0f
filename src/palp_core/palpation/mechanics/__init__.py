"""The mechanics of a yielding probe on a soft phantom: pure functions, usable in a notebook.

>>> from palp_core.palpation.mechanics import Bead, StagePath, Phantom, Probe, contact_model, solve
>>> probe, path = Probe(), StagePath()
>>> model, choice = contact_model(Phantom(bead=Bead(depth_m=0.004)), probe.tip_radius_m)
>>> choice.method.name
'l2'
>>> table = solve(model, probe, 0.008, path.indentation_m, path.from_m, path.to_m)
>>> torque_n_m = table.torque_n_m(path.stage_m())
>>> bool(torque_n_m.max() > torque_n_m[0] > 0.0)
True
"""

from typing import TYPE_CHECKING

from palp_core.lazy_names import lazy_names

if TYPE_CHECKING:
    from palp_core.palpation.mechanics.contact import ContactModel, LayeredHertz
    from palp_core.palpation.mechanics.equilibrium.all_roots import equilibria
    from palp_core.palpation.mechanics.equilibrium.sweep import Sweep, sweep
    from palp_core.palpation.mechanics.equilibrium.sweep_table import SweepTable, solve
    from palp_core.palpation.mechanics.phantom import Bead, Phantom
    from palp_core.palpation.mechanics.probe import Probe
    from palp_core.palpation.mechanics.scene.choice import choose_rung, contact_model, rung_model
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.run import run_scene
    from palp_core.palpation.mechanics.scene.scene import Scene, StagePath, Tolerance

__all__ = [
    "Bead",
    "ContactModel",
    "LayeredHertz",
    "Phantom",
    "Probe",
    "Scene",
    "StagePath",
    "Sweep",
    "SweepTable",
    "Tolerance",
    "choose_rung",
    "contact_model",
    "equilibria",
    "read_scene",
    "run_scene",
    "rung_model",
    "solve",
    "sweep",
]

__getattr__, __dir__ = lazy_names(__name__)
