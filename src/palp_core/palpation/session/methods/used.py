"""What a node reports of the methods it uses: the register's own words, in a message that a run records."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from palp_core.graph.messages.builtin import CheaperMethod, MethodUse
from palp_core.methods import MethodChoice, methods, task
from palp_core.palpation.mechanics.scene.rig import Rig, rig
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.session.method_choices import AUTO, PUBLISHED, chosen_method, what_is_read
from palp_core.palpation.world.model import PAPER, WorldModel

if TYPE_CHECKING:
    from palp_core.palpation.perception.strategy.policies import StiffnessPolicy


def used(
    task_name: str,
    asked: str = "",
    *,
    scene: Scene | None = None,
    given: Mapping[str, float] | None = None,
) -> MethodUse:
    """Return what a node reports of a method that a session takes for a task.

    ``asked`` names it; empty: the register chooses. ``given`` is what is known of the session, where it
    differs from what was published.
    """
    known = {**PUBLISHED, **(given or {})}
    return _use(chosen_method(task_name, scene or Scene(), asked=asked or AUTO, given=known))


def used_of_class(task_name: str, kind: type[Any] | Any, **known: Any) -> MethodUse:
    """Return what a node says of a method that it has as a class or function; further as :func:`used`.

    One that the register does not know is named by its module, and states no error.
    """
    place = f"{kind.__module__}:{kind.__qualname__}"
    declared = next((one.name for one in methods(task_name) if one.place == place), "")
    if declared:
        return used(task_name, declared, **known)
    asked_of = task(task_name)
    return MethodUse(
        task=task_name,
        name=place,
        asked=True,
        output=asked_of.output,
        tolerance=asked_of.tolerance,
        per=asked_of.per,
    )


def policy_use(policy: StiffnessPolicy) -> MethodUse:
    from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent

    if isinstance(policy, InformationGainLatent) and not policy.model.offset_sd.size:
        return used("policy", "information_gain")  # nothing is known to stay
    return used_of_class("policy", type(policy))


def rig_of(phantom: Mapping[str, Any]) -> Rig:
    """Return what a simulated phantom touches, by its node's parameters and their files as they are now."""
    names = ("phantoms", "scene", "tolerance", "friction", "tip_mass_kg")
    given = {name: phantom[name] for name in names if name in phantom}
    if "indentation_mm" in phantom:
        given["indentation_m"] = phantom["indentation_mm"] * 1e-3
    if "from_m" in phantom:
        given["ends_m"] = phantom["from_m"], phantom["to_m"]
    if "reading" in phantom:
        given["read"] = what_is_read(phantom["reading"], phantom["feature"])
    return rig(**given)


def rig_uses(rig: Rig, speed_m_s: float | None, world: WorldModel = PAPER) -> list[MethodUse]:
    """Return the methods of a simulated phantom: the contact model of each phantom, and of the motion.

    ``speed_m_s`` is the stage's, None before the first sweep. ``world`` is reported with the scene.
    """
    common: dict[str, Any] = {"probe": asdict(rig.probe), "indentation_m": rig.indentation_m}
    if not world.plain:
        common["world"] = {"name": world.name, **world.values()}
    uses = [
        _use(choice, of=code, scene=json.dumps({"phantom": asdict(rig.phantoms[code]), **common}))
        for code, choice in rig.choices.items()
    ]
    if speed_m_s is not None:
        uses.append(_use(rig.motion(speed_m_s), scene=json.dumps({"speed_m_s": speed_m_s})))
    return uses


def _use(choice: MethodChoice, **more: str) -> MethodUse:
    method, names = choice.method, [one.name for one in choice.candidates]
    place = names.index(method.name)
    bound = choice.candidates[place].bound
    return MethodUse(
        task=method.task,
        name=method.name,
        asked=choice.asked,
        output=choice.output,
        tolerance=choice.tolerance,
        bound=bound or 0.0,
        bounded=bound is not None,
        evidence=method.evidence,
        cheaper=[
            CheaperMethod(name=one.name, why=one.state) for one in choice.candidates[:place] if one.mark
        ],
        cost_s=method.cost_s,
        per=task(method.task).per,
        **more,
    )
