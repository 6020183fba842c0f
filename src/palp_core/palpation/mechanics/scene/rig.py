"""The touch of a simulated rig: phantoms by code, the probe, and the rung that each phantom needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from palp_core.methods import MethodChoice, errors_name
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import choose_rung, moved_by, rung_model
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.guard import speed_guard, sweep_guards
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.scene import RINGS_M, Scene, StagePath, Tolerance

if TYPE_CHECKING:
    from palp_core.palpation.mechanics.contact.model import ContactModel
    from palp_core.palpation.mechanics.equilibrium.sweep import Sweep


@dataclass(frozen=True)
class Rig:
    """What a simulated rig touches, and with what."""

    probe: Probe  # Dimensions of the probe
    indentation_m: float  # Nominal indentation
    output: str  # What the contact must get right
    tolerance: float  # How right
    phantoms: dict[str, Phantom]  # By code
    choices: dict[str, MethodChoice]  # The rung of each phantom, by code

    @property
    def by_depth(self) -> list[str]:
        """The codes in the order of their depths, bare gel last: that in which anything is set up.

        Set-ups leave files with times behind, and an error names the first phantom that has one: in
        the order of codes both would unblind a blinded session's depths.
        """
        return _by_depth(self.phantoms)

    def model(self, code: str) -> ContactModel:
        """Return a phantom's contact model, ready to use."""
        method, probe = self.choices[code].method, self.probe
        with errors_name(method):
            return rung_model(method.name, self.phantoms[code], probe.tip_radius_m)

    def motion(self, speed_m_s: float) -> MethodChoice:
        """Return the stated error of its quasi-static sweeps at a speed of the stage; it has no others."""
        return moved_by("quasi_static", self.output, self.tolerance, speed_m_s)

    def met(self, code: str, solved: Sweep, speed_m_s: float | None = None) -> tuple[str, ...]:
        """Return what a sweep over a phantom met that its record must say."""
        words = sweep_guards(self.phantoms[code], self.probe, self.choices[code].method.name, solved)
        return words if speed_m_s is None else (*words, *speed_guard(self.motion(speed_m_s)))


def rig(
    *,
    phantoms: str = "",
    scene: str = "",
    read: str = "peak",
    tolerance: float = Tolerance.relative,
    indentation_m: float = StagePath.indentation_m,
    friction: float = Probe.friction,
    tip_mass_kg: float = Probe.tip_mass_kg,
    ends_m: tuple[float, float] | None = None,
) -> Rig:
    """Return a rig's touch: from a scene file, or without one from the numbers given."""
    given = Scene(
        probe=Probe(friction=friction, tip_mass_kg=tip_mass_kg),
        path=StagePath(indentation_m=indentation_m),
        ring_m=RINGS_M,
        tolerance=Tolerance(relative=tolerance),
    )
    if scene:
        given = read_scene(scene)
    if ends_m is not None:
        given = replace(given, path=replace(given.path, from_m=ends_m[0], to_m=ends_m[1]))
    given = given.read_by(read)
    found, asked = load_phantoms(phantoms, given.phantom if scene else None), given.tolerance
    chosen = {code: choose_rung(replace(given, phantom=found[code])).contact for code in _by_depth(found)}
    choices = {code: chosen[code] for code in found}
    return Rig(given.probe, given.path.indentation_m, asked.bound_on, asked.relative, found, choices)


def _by_depth(phantoms: Mapping[str, Phantom]) -> list[str]:
    return sorted(phantoms, key=lambda code: bead.depth_m if (bead := phantoms[code].bead) else math.inf)
