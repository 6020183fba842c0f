"""Which rung answers a scene, why, and what it costs: the register's one choice, put to a scene."""

from dataclasses import dataclass

import palp_core.palpation.mechanics.contact  # noqa: F401 -- declares the rungs
from palp_core.errors import MethodError
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import RINGS_M, Scene, Tolerance, yielding
from palp_core.palpation.methods import Method, MethodChoice, Quantities, choose, find, methods


@dataclass(frozen=True)
class Candidate:
    """What one rung offers a scene.

    Attributes:
        rung: Its name.
        bound: Stated relative error of the scene's output there; None where it vouches for none.
        cost_s: Typical seconds of CPU for set-up and a sweep, nothing cached.
        verdict: Why it was taken or not.
    """

    rung: str
    bound: float | None
    cost_s: float
    verdict: str


@dataclass(frozen=True)
class SceneChoice:
    """The rung for a scene.

    Attributes:
        method: The chosen rung as declared.
        bound: Its stated relative error of the scene's output; None where it vouches for none.
        reason: Why it was chosen, in words.
        candidates: All rungs, cheapest first.
        motion: Whether the joint is solved quasi-statically or with inertia, and why.
    """

    method: Method
    bound: float | None
    reason: str
    candidates: tuple[Candidate, ...]
    motion: str

    @property
    def rung(self) -> str:
        """Name of the rung."""
        return self.method.name


def choose_rung(scene: Scene, rung: str | None = None) -> SceneChoice:
    """Return the cheapest rung that is good enough for a scene, or the one asked for with its stated error.

    Args:
        scene: What is swept, and how right it must be.
        rung: Name of a rung to take regardless of the tolerance.

    Raises:
        MethodError: No rung is good enough, the one that is takes longer than the budget, or there is no
            such.
    """
    quantities, asked = scene.quantities(), scene.tolerance
    bound: float | None
    if rung is None:
        choice = choose("contact", asked.output, asked.relative, quantities)
        chosen, bound, reason = choice.method, choice.bound, choice.reason
    else:
        chosen = find("contact", rung)
        bound = chosen.bound(asked.output, quantities)
        stated = (
            f"'{asked.output}' within {bound:.1%}"
            if bound is not None
            else f"no bound on '{asked.output}' here"
        )
        reason = f"{rung}: asked for by name; {stated}, evidence {chosen.evidence}"
        if bound is None and chosen.fails:
            reason += f"; it fails at: {chosen.fails}; finer: {chosen.survivor or 'none'}"
    candidates = tuple(_candidate(one, quantities, asked, chosen.name) for one in methods("contact"))
    cost_s = chosen.cost_s * len(scene.phantoms)
    if rung is None and scene.budget_s is not None and cost_s > scene.budget_s:
        affordable = [
            c for c in candidates if c.bound is not None and c.cost_s * len(scene.phantoms) <= scene.budget_s
        ]
        best = min(affordable, key=lambda c: c.bound or 0.0, default=None)
        offer = f"{best.rung} gives {best.bound:.1%}" if best else "no rung vouches for it"
        raise MethodError(
            f"'{asked.output}' within {asked.relative:.1%} takes {chosen.name}, about {cost_s:g} s with "
            f"nothing cached; "
            f"budget_s is {scene.budget_s:g}, for which {offer}; raise budget_s or relax the tolerance"
        )
    return SceneChoice(chosen, bound, reason, candidates, _motion(scene))


def _candidate(one: Method, quantities: Quantities, asked: Tolerance, chosen: str) -> Candidate:
    bound = one.bound(asked.output, quantities)
    if one.name == chosen:
        verdict = "chosen"
    elif bound is None:
        verdict = f"vouches for no '{asked.output}' here"
    else:
        verdict = "not right enough" if bound > asked.relative else "right enough, but dearer"
    return Candidate(one.name, bound, one.cost_s, verdict)


def _motion(scene: Scene) -> str:
    """Say whether inertia may be left out."""
    slow = find("motion", "quasi_static")
    quantities = scene.quantities() | {"speed_m_s": scene.path.speed_m_s}
    output = "peak" if scene.tolerance.output in ("peak", "separation", "decision") else "contrast"
    bound = slow.bound(output, quantities)
    speed = f"{scene.path.speed_m_s:g} m/s"
    if bound is not None:
        return f"quasi_static: at {speed} inertia and damping change the {output} by {bound:.1%} at most"
    return (
        f"quasi_static, without a stated bound on the {output} at {speed} and these rings: {slow.fails}; "
        "palp_core.palpation.mechanics.equilibrium.dynamics.simulate has inertia"
    )


def rung_model(rung: str, phantom: Phantom, tip_radius_m: float) -> ContactModel:
    """Return a rung by name, ready to use, at its usual resolution.

    Raises:
        MethodError: There is no such rung.
        MechanicsError: It cannot be set up for this phantom and ball.
    """
    model: ContactModel = find("contact", rung).target(phantom, tip_radius_m)
    return model


def contact_model(
    phantom: Phantom,
    tip_radius_m: float,
    output: str = "peak",
    tolerance: float = 0.02,
    indentation_m: float | None = None,
) -> tuple[ContactModel, MethodChoice]:
    """Return the cheapest contact rung that is good enough for any ring and probe, ready to use, and why.

    Args:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        output: What must be right: ``peak`` (largest torque) or ``contrast`` (peak minus local base).
        tolerance: Largest acceptable relative error of it.
        indentation_m: Nominal indentation, by the published joint; None leaves it out of the choice.

    Raises:
        MethodError: No declared rung is good enough in this scene; the message says what each vouches for.
    """
    quantities: dict[str, float | tuple[float, ...]] = dict(phantom.scene(tip_radius_m))
    if indentation_m is not None:
        probe = Probe(tip_radius_m=tip_radius_m)
        quantities["indentation_m"] = indentation_m
        quantities["yielding"] = tuple(yielding(phantom, probe, indentation_m, r) for r in RINGS_M)
    choice = choose("contact", output, tolerance, quantities)
    return rung_model(choice.method.name, phantom, tip_radius_m), choice
