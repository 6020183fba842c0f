"""The touch of a simulated rig: phantoms by code, the probe, and the rung that each phantom needs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from palp_core.methods import MethodChoice, at_work, choose
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import choose_rung, moved_by, rung_model
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.guard import speed_guard, sweep_guards
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.scene import RINGS_M, pressed


@dataclass(frozen=True)
class Rig:
    """What a simulated rig touches, and with what.

    Attributes:
        probe: Dimensions of the probe.
        indentation_m: Nominal indentation.
        output: What the contact must get right.
        tolerance: How right.
        phantoms: By code.
        choices: The rung of each phantom, by code.
    """

    probe: Probe
    indentation_m: float
    output: str
    tolerance: float
    phantoms: dict[str, Phantom]
    choices: dict[str, MethodChoice]

    @property
    def by_depth(self) -> list[str]:
        """The codes in the order of their depths, bare gel last: that in which anything is set up.

        Set-ups leave files with times behind, and mistakes are told of the first phantom that has one: in
        the order of codes both would tell a blinded session's depths.
        """
        return _by_depth(self.phantoms)

    def model(self, code: str) -> ContactModel:
        """Return a phantom's contact model, ready to use."""
        method, probe = self.choices[code].method, self.probe
        with at_work(method):
            return rung_model(method.name, self.phantoms[code], probe.tip_radius_m, probe.tip)

    def motion(self, speed_m_s: float) -> MethodChoice:
        """Return what its quasi-static sweeps vouch for at a speed of the stage: they are all it has."""
        return moved_by("quasi_static", self.output, self.tolerance, speed_m_s)

    def met(self, code: str, solved: Sweep, speed_m_s: float | None = None) -> tuple[str, ...]:
        """Return what a sweep over a phantom met that its record must say.

        Args:
            code: The phantom.
            solved: The sweep.
            speed_m_s: Of the stage, if that is known.
        """
        words = sweep_guards(self.phantoms[code], self.probe, self.choices[code].method.name, solved)
        return words if speed_m_s is None else (*words, *speed_guard(self.motion(speed_m_s)))


def rig(
    *,
    phantoms: str = "",
    scene: str = "",
    output: str = "peak",
    tolerance: float = 0.02,
    indentation_m: float | None = 0.004,
    friction: float = 0.3,
    tip_mass_kg: float = 0.008,
) -> Rig:
    """Return a rig's touch: from a scene file, or without one from the numbers given.

    Args:
        phantoms: File of phantoms by code; without it the paper's three depths, in the scene's gel if there
            is one.
        scene: Scene file; it gives probe, indentation and tolerance, and the arguments below are not used.
        output: What the contact must get right.
        tolerance: How right.
        indentation_m: Nominal indentation; None leaves it out of the choice.
        friction: Coulomb coefficient.
        tip_mass_kg: Mass of the tip link.

    Raises:
        MechanicsError: A file is wrong; the message says where.
        MethodError: No rung is good enough for a phantom.
    """
    choices: dict[str, MethodChoice] = {}
    if scene:
        given = read_scene(scene)
        found = load_phantoms(phantoms, given.phantom)
        for code in _by_depth(found):
            choices[code] = choose_rung(replace(given, phantom=found[code])).contact
        asked = given.tolerance
        choices = {code: choices[code] for code in found}
        return Rig(given.probe, given.path.indentation_m, asked.bound_on, asked.relative, found, choices)
    probe, found = Probe(friction=friction, tip_mass_kg=tip_mass_kg), load_phantoms(phantoms)
    for code in _by_depth(found):
        phantom = found[code]
        quantities: dict[str, float | tuple[float, ...]] = {
            **phantom.scene(probe.tip_radius_m),
            "friction": probe.friction,
            "tip_mass_kg": probe.tip_mass_kg,
        }
        if indentation_m is not None:
            quantities |= pressed((phantom,), probe, indentation_m, RINGS_M)
        choices[code] = choose("contact", output, tolerance, quantities)
    choices = {code: choices[code] for code in found}
    return Rig(probe, 0.004 if indentation_m is None else indentation_m, output, tolerance, found, choices)


def _by_depth(phantoms: Mapping[str, Phantom]) -> list[str]:
    return sorted(phantoms, key=lambda code: bead.depth_m if (bead := phantoms[code].bead) else math.inf)
