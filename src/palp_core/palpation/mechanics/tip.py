"""The ball's form: a sphere, or the paraboloid that Hertz's law stands for."""

import math
from typing import Literal, get_args

import numpy as np

from palp_core.errors import OutOfRange
from palp_core.units import Float64Array

TipForm = Literal["sphere", "paraboloid"]
"""What presses the gel: the ball as it is, or the paraboloid of the same curvature (r^2 / 2R)."""

TIP_FORMS: tuple[TipForm, ...] = get_args(TipForm)

_FORCE = (1.0, -1.0 / 10.0, -1.0 / 840.0, 11.0 / 15120.0)
_RADIUS_SQUARED = (1.0, -1.0 / 3.0, 1.0 / 45.0, 1.0 / 189.0)
"""Of a rigid sphere on a half-space: force over Hertz's, and the contact's a^2 over R delta, in delta / R.

Sneddon, International Journal of Engineering Science 3 (1965) 47, gives both by the contact's radius a:
delta = (a/2) ln((R+a)/(R-a)), N = E / (1 - nu^2) ((a^2 + R^2)/2 ln((R+a)/(R-a)) - a R). These are the series
of that pair with a eliminated; up to an indentation of R they are off by less than 0.03 and 0.1 %.
"""


def require_form(tip: str) -> None:
    """Check the name of a form.

    Raises:
        OutOfRange: There is no such form.
    """
    if tip not in TIP_FORMS:
        raise OutOfRange("tip", f"'{tip}' is no form of the tip; use {' or '.join(TIP_FORMS)}")


def gap_m(tip: TipForm, radius_m: float, aside_m: Float64Array) -> Float64Array:
    """Return how far the tip's surface lies above its lowest point.

    Args:
        tip: The form.
        radius_m: Radius of the ball.
        aside_m: Distance from the ball's axis, any shape; a sphere's is that of its equator beyond it.
    """
    square: Float64Array = np.square(aside_m)
    if tip == "paraboloid":
        return square / (2.0 * radius_m)
    square = np.minimum(square, radius_m**2)
    return np.asarray(square / (radius_m + np.sqrt(radius_m**2 - square)))


def overlap_radius_m(tip: TipForm, radius_m: float, indentation_m: float) -> float:
    """Return the distance from the axis within which the undeformed bodies overlap."""
    square = 2.0 * radius_m * indentation_m
    return math.sqrt(square if tip == "paraboloid" else square - indentation_m**2)


def contact_radius_m(tip: TipForm, radius_m: float, indentation_m: float) -> float:
    """Return the radius of the contact on a half-space."""
    share = indentation_m / radius_m
    shape = 1.0 if tip == "paraboloid" else float(np.polynomial.Polynomial(_RADIUS_SQUARED)(share))
    return radius_m * math.sqrt(share * shape)


def over_paraboloid(tip: TipForm, power: int) -> Float64Array:
    """Return N a^power on a half-space over that of the paraboloid, as a series in delta / R.

    Args:
        tip: The form; the paraboloid's series is 1.
        power: Of the contact's radius a, from 0.
    """
    if tip == "paraboloid":
        return np.ones(1)
    count = len(_FORCE)
    root = np.zeros(count)  # of the square's series, term by term
    root[0] = 1.0
    for n in range(1, count):
        root[n] = 0.5 * (_RADIUS_SQUARED[n] - root[1:n] @ root[n - 1 : 0 : -1])
    series = np.array(_FORCE)
    for _ in range(power):
        series = np.convolve(series, root)[:count]
    return series
