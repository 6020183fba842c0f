"""A scene: the path of the stage over a phantom, and the contact rung that is good enough for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

import palp_core.mechanics.contact  # noqa: F401 -- declares the rungs
from palp_core.errors import OutOfRange
from palp_core.mechanics.contact.model import ContactModel
from palp_core.mechanics.limits import require
from palp_core.mechanics.phantom import Phantom
from palp_core.methods import Choice, choose
from palp_core.units import Float64Array

__all__ = ["Path", "contact_model"]


@dataclass(frozen=True, kw_only=True)
class Path:
    """One straight sweep of the stage at constant height; stage position 0 is over the bead.

    Attributes:
        indentation_m: Nominal indentation of the upright probe; assumed.
        speed_m_s: Speed of the stage; published.
        from_m: Stage position at the start; assumed.
        to_m: Stage position at the end; smaller than ``from_m`` for a sweep towards -Y; assumed.

    Raises:
        OutOfRange: A value is not a number, the speed is not positive or the path has no length.
    """

    indentation_m: float = 0.004
    speed_m_s: float = 0.02
    from_m: float = -0.03
    to_m: float = 0.05

    def __post_init__(self) -> None:
        require("indentation_m", self.indentation_m, -1.0, 1.0, "give metres, as in 0.004")
        require("speed_m_s", self.speed_m_s, 1e-9, 10.0, "give a positive speed in m/s, as in 0.02")
        require("from_m", self.from_m, -10.0, 10.0, "give metres, as in -0.03")
        require("to_m", self.to_m, -10.0, 10.0, "give metres, as in 0.05")
        if self.from_m == self.to_m:
            raise OutOfRange("to_m", f"the path starts and ends at {self.to_m:g}; give it a length")

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return abs(self.to_m - self.from_m) / self.speed_m_s

    def stage_m(self, sample_hz: float = 1000.0) -> Float64Array:
        """Return the stage positions at a sampling rate, from the start to the last sample on the path."""
        require("sample_hz", sample_hz, 1e-3, 1e6, "give a positive rate in Hz, as in 1000")
        count = math.floor(self.duration_s * sample_hz * (1.0 + 1e-12)) + 1
        step_m = math.copysign(self.speed_m_s / sample_hz, self.to_m - self.from_m)
        positions: Float64Array = self.from_m + step_m * np.arange(count, dtype=np.float64)
        return positions


def contact_model(
    phantom: Phantom,
    tip_radius_m: float,
    output: str = "peak",
    tolerance: float = 0.02,
    indentation_m: float | None = None,
) -> tuple[ContactModel, Choice]:
    """Return the cheapest contact rung that is good enough, ready to use, and why it was chosen.

    Args:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        output: What must be right: ``peak`` (largest torque) or ``contrast`` (peak minus local base).
        tolerance: Largest acceptable relative error of it.
        indentation_m: Nominal indentation; None leaves it out of the choice.

    Raises:
        MethodError: No declared rung is good enough in this scene; the message says what each vouches for.
    """
    scene = phantom.scene() | {"tip_radius_m": tip_radius_m}
    if indentation_m is not None:
        scene["indentation_m"] = indentation_m
    choice = choose("contact", output, tolerance, scene)
    model: ContactModel = choice.method.target(phantom, tip_radius_m)
    return model, choice
