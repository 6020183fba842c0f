"""What the points of a task come to: the front, the chosen one, those that fail and what survives there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from palp_core.methods.measured import REFERENCE, Measured
from palp_core.palpation.session.method_choices import TaskChoice
from palp_core.palpation.studies.toolkit.pareto import pareto_front


@dataclass(frozen=True)
class Judgement:
    """A point, and what it is in the task.

    Attributes:
        point: The point.
        on_front: Whether no other of the same output is both cheaper and more right.
        chosen: Whether it is what the register gives the scene.
        fails: Why it is not to be trusted here, in words: as measured, or as declared; empty if it is.
        survivor: The method to use where it fails; empty if there is none, or it does not.
    """

    point: Measured
    on_front: bool
    chosen: bool
    fails: str
    survivor: str


def judged(choice: TaskChoice, points: Sequence[Measured], output: str) -> list[Judgement]:
    """Return the points of one output, each with what it is.

    Args:
        choice: The task in the scene.
        points: What was measured, of any output.
        output: Which.
    """
    here = [one for one in points if one.output == output]
    able = [one for one in here if not one.condition and not one.fails and math.isfinite(one.error)]
    front = [able[i] for i in pareto_front([one.cost_s for one in able], [one.error for one in able])]
    chosen = choice.chosen.name if choice.chosen else ""
    declared = {one.name: (one, offer) for one, offer in choice.declared()}
    found = []
    for one in here:
        fails = one.fails
        method, offer = declared.get(one.method, (None, None))
        if method is not None and offer is not None and not fails and one.condition != REFERENCE:
            doubtful = offer.mark == "reference" or (offer.mark == "refused" and offer.bound is None)
            fails = (method.fails or offer.why) if doubtful else ""
        survivor = method.survivor if method is not None and fails else ""
        ringed = one.method == chosen and one.usual and not one.condition
        found.append(Judgement(one, one in front, ringed, fails, survivor))
    return found


def outputs(choice: TaskChoice, points: Sequence[Measured]) -> list[str]:
    """Return the outputs that were measured, what the scene asks for first."""
    return sorted(dict.fromkeys(one.output for one in points), key=lambda name: name != choice.output)


def usual_point(found: Sequence[Judgement], method: str, condition: str = "") -> Judgement | None:
    """Return the point of a method as it is taken, under a condition if it was measured under that."""
    own = [one for one in found if one.point.method == method]
    return min(own, key=lambda one: (not one.point.usual, one.point.condition != condition), default=None)
