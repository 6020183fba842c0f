"""An error of a method that was seen, and the quantities of the session in which it was."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from palp_core.methods import Quantities, find
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.reading_table import (
    RATE_HZ,
    SPEED_M_PER_S,
    Gel,
    scene_of,
)


@dataclass(frozen=True)
class Seen:
    """How wrong a method was.

    Attributes:
        task: Its task.
        method: Its name.
        output: What is wrong by ``error``.
        error: As the bounds of the task count.
        quantities: Of the session, as a method is chosen by.
        condition: The session in words.
    """

    task: str
    method: str
    output: str
    error: float
    quantities: Quantities
    condition: str

    @property
    def bound(self) -> float | None:
        """What the method states for it; None where it vouches for nothing."""
        return find(self.task, self.method).bound(self.output, self.quantities)

    @property
    def kept(self) -> bool:
        """Whether the bound, if there is one, is kept."""
        return self.bound is None or self.error <= self.bound


def touch_quantities(gel: Gel) -> dict[str, float | tuple[float, ...]]:
    """Return what methods may know of a touch that is simulated."""
    depths_m = sorted(gel.depths_m)
    ratio = min(b / a for a, b in itertools.pairwise(depths_m))
    return {
        **scene_of(gel, depths_m[0]).quantities(),
        "depth_m": gel.depths_m,
        "speed_m_s": SPEED_M_PER_S,
        "sample_hz": RATE_HZ,
        "noise_n_m": gel.noise_factor * RESOLUTION_N_M,
        "stiffest_m": max(gel.rings_m),
        "class_count": float(len(depths_m)),
        "class_ratio": ratio,
    }


def session_quantities(gel: Gel, conditions: Conditions) -> dict[str, float | tuple[float, ...]]:
    """Return what methods may know of a session that is simulated."""
    return touch_quantities(gel) | {
        "training_count": float(conditions.training),
        "probe_count": float(conditions.max_probes),
        "ring_sd_m": conditions.ring_sd_m,
        "height_sd_m": conditions.height_sd_m,
        "outlier_share": 0.0,
    }


def in_words(gel: Gel, conditions: Conditions | None = None) -> str:
    """Return where a simulated session differs from the usual one."""
    usual: list[tuple[object, object]] = [(gel, Gel())]
    if conditions is not None:
        usual.append((conditions, Conditions(mounting="each_trial")))
    words = [
        f"{name} {value}"
        for one, other in usual
        for name, value in vars(one).items()
        if value != vars(other)[name] and name not in ("trials", "rings_m")
    ]
    return ", ".join(words) or "as published"
