"""Which rung answers a scene, why, and what it costs: the register's one choice, put to a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from palp_core.errors import MethodError
from palp_core.methods import MethodChoice, Quantities, choose, find
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import RINGS_M, Scene, motion_output, pressed

if TYPE_CHECKING:
    from palp_core.palpation.mechanics.contact.model import ContactModel


@dataclass(frozen=True)
class SceneChoice:
    """What a scene is computed with."""

    contact: MethodChoice  # The contact rung
    motion: MethodChoice  # Whether the joint is solved quasi-statically or with inertia

    @property
    def rung(self) -> str:
        """Name of the rung."""
        return self.contact.name

    @property
    def bound(self) -> float | None:
        """The rung's stated relative error of the scene's output; None where it states none."""
        return self.contact.bound


def choose_rung(scene: Scene, rung: str | None = None) -> SceneChoice:
    """Return the cheapest contact model that meets a scene's tolerance, or the named one, with its error.

    Args:
        scene: What is swept, and how right it must be.
        rung: Name of a rung to take regardless of the tolerance.

    Raises:
        MethodError: No rung is good enough, the one that is takes longer than the budget, or there is no
            such.
    """
    asked = scene.tolerance
    contact = choose(
        "contact",
        asked.bound_on,
        asked.relative,
        scene.quantities(),
        asked=rung or "",
        uses=len(scene.phantoms),
        budget_s=None if rung else scene.budget_s,
    )
    return SceneChoice(contact, choose_motion(scene))


def choose_motion(scene: Scene) -> MethodChoice:
    """Return whether inertia may be left out of a scene, as the register has it.

    What leaves inertia out may take as much of the tolerance again as the contact; where nothing that is
    declared is bounded so well, the quasi-static joint is taken by name, without a bound.
    """
    output, tolerance, speed_m_s = scene.tolerance.output, scene.tolerance.relative, scene.path.speed_m_s
    try:
        return moved_by("", output, tolerance, speed_m_s, scene.quantities())
    except MethodError:
        return moved_by("quasi_static", output, tolerance, speed_m_s, scene.quantities())


def moved_by(
    asked: str, output: str, tolerance: float, speed_m_s: float, quantities: Quantities | None = None
) -> MethodChoice:
    """Return what the joint's inertia is treated by, as the register has it."""
    known = {**(quantities or {}), "speed_m_s": speed_m_s}
    return choose("motion", motion_output(output), tolerance, known, asked=asked)


def rung_model(rung: str, phantom: Phantom, tip_radius_m: float) -> ContactModel:
    """Return a contact model by name, ready to use, at its usual resolution.

    Args:
        rung: Its name.
        phantom: What is touched.
        tip_radius_m: Radius of the ball.

    A bead beside the path is felt at its distance.

    Raises:
        MethodError: There is no such rung.
        MechanicsError: It cannot be set up for this phantom and ball.
    """
    model: ContactModel = find("contact", rung).target(phantom, tip_radius_m)
    bead = phantom.bead
    if bead is None or bead.beside_m == 0.0:
        return model
    from palp_core.palpation.mechanics.contact.model import BesideBead

    return BesideBead(model, bead.beside_m)


def contact_model(
    phantom: Phantom,
    tip_radius_m: float,
    output: str = "peak",
    tolerance: float = 0.02,
    indentation_m: float | None = None,
) -> tuple[ContactModel, MethodChoice]:
    """Return the cheapest contact model for any ring and probe, ready to use, and the reason.

    Args:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        output: What must be right: ``peak``, ``contrast`` or ``trace``.
        tolerance: Largest acceptable relative error of it.
        indentation_m: Nominal indentation, by the published joint; None leaves it out of the choice.

    Raises:
        MethodError: No declared rung is good enough in this scene; the message has the bound of each.
    """
    quantities: dict[str, float | tuple[float, ...]] = dict(phantom.scene(tip_radius_m))
    if indentation_m is not None:
        probe = Probe(tip_radius_m=tip_radius_m)
        quantities |= pressed((phantom,), probe, indentation_m, RINGS_M)
    choice = choose("contact", output, tolerance, quantities)
    return rung_model(choice.method.name, phantom, tip_radius_m), choice
