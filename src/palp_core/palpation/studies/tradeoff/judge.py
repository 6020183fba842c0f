"""What the points of a task come to: the front, the chosen one, those that fail and what survives there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from palp_core.methods.choice import INACCURATE, UNAVAILABLE
from palp_core.methods.measured import REFERENCE, Measured
from palp_core.palpation.session.method_choices import TaskChoice
from palp_core.palpation.studies.toolkit.pareto import pareto_front


@dataclass(frozen=True)
class Judgement:
    """A point, and what it is in its task.

    Attributes:
        point: The point.
        at_home: Whether it was measured as the scene has it, or as its panel says.
        on_front: Whether no other of its panel that can be trusted is both cheaper and more right.
        chosen: Whether it is what the register gives the scene.
        fails: Why it is not to be trusted here, in words: as measured, or as declared; empty if it is.
        survivor: The method to use where it fails; empty if there is none, or it does not.
    """

    point: Measured
    at_home: bool
    on_front: bool
    chosen: bool
    fails: str
    survivor: str


@dataclass(frozen=True)
class Panel:
    """Points that can be compared: of one output, and, where all have one, under one condition.

    Attributes:
        output: What the error is of.
        condition: Under which all were measured; empty: the scene itself, and whatever else there is.
        found: The points.
    """

    output: str
    condition: str
    found: tuple[Judgement, ...]

    @property
    def title(self) -> str:
        """What sets it apart from others of its task."""
        return f"{self.output}, {self.condition}" if self.condition else self.output


def panels(choice: TaskChoice, points: Sequence[Measured]) -> list[Panel]:
    """Return the panels of a task, what the scene asks for first.

    Args:
        choice: The task in the scene.
        points: What was measured.
    """
    found = []
    for output in sorted(dict.fromkeys(one.output for one in points), key=lambda name: name != choice.output):
        here = [one for one in points if one.output == output]
        conditions = dict.fromkeys(one.condition for one in here)
        for home in [""] if "" in conditions or set(conditions) == {REFERENCE} else conditions:
            own = [one for one in here if not home or one.condition == home]
            found.append(Panel(output, home, tuple(_judged(choice, own, home))))
    return found


def _judged(choice: TaskChoice, points: Sequence[Measured], home: str) -> list[Judgement]:
    able = [one for one in points if one.condition == home and not one.fails and math.isfinite(one.error)]
    best = pareto_front([one.cost_s for one in able], [one.error for one in able])
    front = [able[i] for i in best]
    chosen = choice.chosen.name if choice.chosen else ""
    declared = {one.name: (one, offer) for one, offer in choice.declared()}
    found = []
    for one in points:
        fails = one.fails
        method, offer = declared.get(one.method, (None, None))
        if method is not None and offer is not None and not fails and one.condition != REFERENCE:
            doubtful = offer.mark == UNAVAILABLE or (offer.mark == INACCURATE and offer.bound is None)
            fails = (method.fails or offer.why) if doubtful else ""
        survivor = method.survivor if method is not None and fails else ""
        at_home = one.condition == home
        ringed = one.method == chosen and one.usual and at_home
        found.append(Judgement(one, at_home, one in front, ringed, fails, survivor))
    return found


def usual_point(found: Sequence[Judgement], method: str, condition: str = "") -> Judgement | None:
    """Return the point of a method as it is taken, under a condition if it was measured under that."""
    own = [one for one in found if one.point.method == method]
    return min(own, key=lambda one: (not one.point.usual, one.point.condition != condition), default=None)
