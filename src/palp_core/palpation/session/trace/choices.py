"""What of a palpation may be chosen on a rig, within the bounds of its launch file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Self

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.actions import SweepAction
from palp_core.palpation.session.trace.actions import ActionSet

VARIED = ("speed", "indentation", "path", "direction")
"""What may be chosen beside the ring."""


@dataclass(frozen=True)
class ActionChoices:
    """What may be chosen beside the ring; the first of each is the launch file's own.

    Attributes:
        home: The launch file's own sweep; its ring counts for nothing.
        indentations_m: Nominal indentations.
        speeds_m_per_s: Of the stage.
        paths_m: Beginning and end of each path.
    """

    home: SweepAction
    indentations_m: tuple[float, ...]
    speeds_m_per_s: tuple[float, ...]
    paths_m: tuple[tuple[float, float], ...]

    @classmethod
    def within(
        cls,
        vary: str,
        home: SweepAction,
        *,
        speeds_m_per_s: Sequence[float],
        indentations_m: Sequence[float],
        inset_m: float,
        fastest_m_per_s: float,
    ) -> Self:
        """Return what may be chosen.

        Args:
            vary: What beside the ring, of :data:`VARIED`, with commas; empty: the ring alone.
            home: The launch file's own sweep.
            speeds_m_per_s: Beside its own.
            indentations_m: Beside its own.
            inset_m: How much later paths may begin, and how much sooner end.
            fastest_m_per_s: What no stage may pass.

        Raises:
            PerceptionError: A word is none, or a number is beyond its limit; it begins with the parameter.
        """
        varied = {word.strip() for word in vary.split(",") if word.strip()}
        if wrong := sorted(varied - set(VARIED)):
            raise PerceptionError(f"vary: '{wrong[0]}' cannot be chosen; what can is {', '.join(VARIED)}")
        for speed in speeds_m_per_s:
            if speed > fastest_m_per_s:
                raise PerceptionError(
                    f"speeds_mm_s: {speed * 1e3:g} mm/s is faster than the limit of {fastest_m_per_s * 1e3:g}"
                )
        for one in indentations_m:
            if one > home.indentation_m + 1e-9:
                raise PerceptionError(
                    f"indentations_mm: {one * 1e3:g} mm is deeper than the {home.indentation_m * 1e3:g} mm "
                    "where the stage scans, below which it never goes; a scene file says how deep that is"
                )
        if 2.0 * inset_m > home.way_m - 1e-6:
            raise PerceptionError(f"inset_mm: {inset_m * 1e3:g} mm at both ends leaves nothing of the path")
        ends = [home.from_m, home.to_m]
        inner = [ends[0] + home.sign * inset_m, ends[1] - home.sign * inset_m]
        there = [(a, b) for a in (ends[0], inner[0]) for b in (ends[1], inner[1])] if "path" in varied else []
        paths = there or [(ends[0], ends[1])]
        if "direction" in varied:
            paths = [*paths, *((b, a) for a, b in paths)]
        deep = indentations_m if "indentation" in varied else ()
        fast = speeds_m_per_s if "speed" in varied else ()
        return cls(
            home,
            _once(home.indentation_m, *deep),
            _once(home.speed_m_per_s, *fast),
            tuple(dict.fromkeys((round(a, 9), round(b, 9)) for a, b in paths)),
        )

    def actions(self, rings_m: Sequence[float]) -> tuple[SweepAction, ...]:
        """Return every combination, at some positions of the ring."""
        return _actions(self, tuple(rings_m))


def _once(*numbers: float) -> tuple[float, ...]:
    return tuple(dict.fromkeys(round(one, 9) for one in numbers))


@cache
def _actions(choices: ActionChoices, rings_m: tuple[float, ...]) -> tuple[SweepAction, ...]:
    return ActionSet(rings_m, choices.indentations_m, choices.speeds_m_per_s, choices.paths_m).actions
