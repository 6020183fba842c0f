"""Sessions in which errors of the methods of perception were measured: what their bounds hold within.

The nightly rows of ``test_method_bounds.py`` measure them again; a bound is the largest error that was seen
in the range and about a third more. Quantities are as of :mod:`palp_core.palpation.session.method_choices`.
"""

from collections.abc import Mapping

from palp_core.methods import Bound, Range

Ranges = Mapping[str, Range]
ENDLESS = 1e9
STEP_N_M = 1.5625e-5 * 1.001
"""A step of the sensor's resolution, 1/64 N mm, with what rounding takes."""

_TOUCH: Ranges = {
    "bead_radius_m": (0.0074, 0.0076),
    "height_m": (0.0295, 0.0305),
    "poisson": (0.485, 0.495),
    "tip_radius_m": (0.0059, 0.0061),
    "tip_mass_kg": (0.007, 0.009),
    "speed_m_s": (0.0195, 0.0205),
    "sample_hz": (990.0, 1010.0),
    "depth_m": (0.0015, 0.012),
    "class_ratio": (2.0, ENDLESS),
}
USUAL: Ranges = {
    **_TOUCH,
    "modulus_pa": (19.5e3, 20.5e3),
    "friction": (0.29, 0.31),
    "indentation_m": (0.0039, 0.0041),
    "class_count": (2.0, 3.0),
}
"""The published touch."""
ABOUT: Ranges = {
    **_TOUCH,
    "modulus_pa": (15e3, 30e3),
    "friction": (0.25, 0.45),
    "indentation_m": (0.003, 0.005),
    "class_count": (2.0, 4.0),
}
"""Touches about it, measured at the corners."""
FELT: Ranges = {"ring_m": (0.004, 0.016)}
"""Rings at which there is something to feel."""
RIG: Ranges = {
    **USUAL,
    "noise_n_m": (0.0, STEP_N_M),
    "stiffest_m": (0.0159, 0.0161),
    "training_count": (25.0, ENDLESS),
    "probe_count": (15.0, 15.0),
    "outlier_share": (0.0, 0.0),
}
"""The published rig, but for how it lands and stands."""
LANDS_M = 0.175e-3
"""Largest spread of a landing: the published +-0.3 mm, read as uniform."""


def by_noise(usual: tuple[float, float, float], about: tuple[float, float, float]) -> list[Bound]:
    """Return bounds on a feature's error for noise up to 1, 2 and 5 steps of the sensor's resolution."""
    steps = (1.0, 2.0, 5.0)
    return [
        Bound("feature", error, {**touch, **FELT, "noise_n_m": (0.0, step * STEP_N_M)})
        for touch, errors in ((USUAL, usual), (ABOUT, about))
        for step, error in zip(steps, errors, strict=True)
    ]


def on_rig(
    output: str,
    error: float,
    *,
    ring_sd_m: float = LANDS_M,
    ring_from_m: float = 0.0,
    height_sd_m: float = 1e-4,
    training_count: float = 25.0,
) -> Bound:
    """Return a bound on the published rig, for landings and heights that spread up to so much."""
    spread = {"ring_sd_m": (ring_from_m, ring_sd_m), "height_sd_m": (0.0, height_sd_m)}
    return Bound(output, error, {**RIG, **spread, "training_count": (training_count, ENDLESS)})
