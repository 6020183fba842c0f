"""The luck of a session, its phantoms and their mountings, as latents of its sweeps.

Every level draws a fixed number of standard normals, whatever the world's parameters are: two worlds that are
drawn with equal generators differ by their parameters alone. Parts of a sweep's latents, one from each level,
are brought together by :func:`together`: until then the bead's distance beside the path has a sign.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from palp_core.palpation.mechanics.tip import contact_radius_m
from palp_core.palpation.world.latents import LATENTS
from palp_core.palpation.world.model import WorldModel
from palp_core.units import Float64Array

PARTS = tuple("beside_m" if name == "beside_m2" else name for name in LATENTS)
"""What a part is of: the latents, but for the bead's distance beside the path, which has a sign."""

_RING, _HEIGHT, _MODULUS, _FRICTION, _ALONG, _BESIDE, _TIP = range(len(LATENTS))
_PRESSED = 0.5
"""Of the nominal indentation is what the dragged tip keeps: assumed, 0.3 to 0.6 from soft to stiff joint."""


def layer_weight(depth_m: float, contact_m: float, poisson: float = 0.49) -> float:
    """Return the share of a surface layer's modulus in what a contact feels; the rest is the gel's under it.

    Gao, Chiu and Lee, International Journal of Solids and Structures 29 (1992) 2471, a first-order
    perturbation for a flat punch, x being the layer's thickness over the contact's radius::

        E = E_under + (E_layer - E_under) I_0
        I_0 = 2/pi atan x + ((1 - 2 nu) x ln((1 + x^2) / x^2) - x / (1 + x^2)) / (2 pi (1 - nu))

    Args:
        depth_m: Thickness of the layer: the bead lies on the cured one, the other is poured over it.
        contact_m: Radius of the contact.
        poisson: Poisson's ratio of both.
    """
    x = depth_m / contact_m
    rest = (1.0 - 2.0 * poisson) * x * math.log((1.0 + x * x) / (x * x)) - x / (1.0 + x * x)
    return 2.0 / math.pi * math.atan(x) + rest / (2.0 * math.pi * (1.0 - poisson))


def session_part(world: WorldModel, rng: np.random.Generator) -> Float64Array:
    """Return what a session's sweeps share, shape (7,): batch, indentation, ball; 3 numbers are drawn."""
    part = np.zeros(len(LATENTS))
    part[[_MODULUS, _HEIGHT, _TIP]] = rng.standard_normal(3) * (
        world.modulus_batch_sd,
        world.indentation_session_sd_m,
        world.tip_radius_session_sd_m,
    )
    return part


def specimen_parts(
    world: WorldModel,
    rng: np.random.Generator,
    depth_m: ArrayLike,
    *,
    tip_radius_m: float = 0.006,
    indentation_m: float = 0.004,
    poisson: float = 0.49,
) -> Float64Array:
    """Return what each phantom is off by: modulus, the layer over the bead, the bead's place. 4 numbers each.

    Args:
        world: The spreads.
        rng: Drawn from.
        depth_m: Gel over each phantom's bead, any shape.
        tip_radius_m: Of the ball; with indentation and Poisson's ratio it says how deep a contact feels.
        indentation_m: Nominal.
        poisson: Poisson's ratio.

    Returns:
        Parts, shape (..., 7).
    """
    depths_m = np.asarray(depth_m, dtype=np.float64)
    contact_m = contact_radius_m(tip_radius_m, _PRESSED * indentation_m)
    weight = np.array([layer_weight(d, contact_m, poisson) for d in depths_m.ravel()]).reshape(depths_m.shape)
    luck = rng.standard_normal((*depths_m.shape, 4))
    parts = np.zeros((*depths_m.shape, len(LATENTS)))
    parts[..., _MODULUS] = (
        world.modulus_specimen_sd * luck[..., 0] + world.layer_modulus_sd * weight * luck[..., 1]
    )
    parts[..., _ALONG] = world.bead_along_specimen_sd_m * luck[..., 2]
    parts[..., _BESIDE] = world.bead_beside_specimen_sd_m * luck[..., 3]
    return parts


def mounting_parts(
    world: WorldModel, rng: np.random.Generator, count: int, height_sd_m: float = 0.0
) -> Float64Array:
    """Return what each mounting is off by, shape (count, 7): height, friction, bead's place; 4 numbers each.

    Args:
        world: The spreads.
        rng: Drawn from.
        count: Mountings.
        height_sd_m: Spread of the surface's height, which the rig has in any world.
    """
    parts = np.zeros((count, len(LATENTS)))
    parts[:, [_HEIGHT, _FRICTION, _ALONG, _BESIDE]] = rng.standard_normal((count, 4)) * (
        height_sd_m,
        world.friction_mounting_sd,
        world.bead_along_mounting_sd_m,
        world.bead_beside_mounting_sd_m,
    )
    return parts


def wear_part(world: WorldModel, path_m: ArrayLike) -> Float64Array:
    """Return what a path swept so far has done to friction and ball, shape (..., 7)."""
    way_m = np.asarray(path_m, dtype=np.float64)
    part = np.zeros((*way_m.shape, len(LATENTS)))
    part[..., _FRICTION], part[..., _TIP] = world.friction_wear_per_m * way_m, world.tip_wear_per_m * way_m
    return part


def ring_part(error_m: ArrayLike) -> Float64Array:
    """Return the part that a ring's landing is, shape (..., 7)."""
    errors_m = np.asarray(error_m, dtype=np.float64)
    part = np.zeros((*errors_m.shape, len(LATENTS)))
    part[..., _RING] = errors_m
    return part


def bead_part(beside_m: float) -> Float64Array:
    """Return the part that a bead's nominal distance beside the path is, shape (7,)."""
    part = np.zeros(len(LATENTS))
    part[_BESIDE] = beside_m
    return part


def together(*parts: Float64Array) -> Float64Array:
    """Return latents of sweeps, shape (..., 7): the parts' sum, the distance beside the path squared."""
    rows = np.array(np.sum(np.broadcast_arrays(*parts), axis=0))
    rows[..., _BESIDE] = rows[..., _BESIDE] ** 2
    return rows


def latent_spread(
    world: WorldModel, depth_m: float = 0.004, *, ring_sd_m: float = 0.0, height_sd_m: float = 0.0
) -> tuple[Float64Array, Float64Array]:
    """Return mean and standard deviation of a sweep's latents over sessions, each of shape (7,).

    The square of a normal distance of variance v has the mean v and the standard deviation sqrt(2) v.

    Args:
        world: The spreads.
        depth_m: Gel over the bead.
        ring_sd_m: Spread of the ring's landing.
        height_sd_m: Spread of the height over mountings.
    """
    contact_m = contact_radius_m(0.006, _PRESSED * 0.004)
    layer = world.layer_modulus_sd * layer_weight(depth_m, contact_m)
    beside = world.bead_beside_specimen_sd_m**2 + world.bead_beside_mounting_sd_m**2
    mean, sd = np.zeros(len(LATENTS)), np.zeros(len(LATENTS))
    mean[_BESIDE] = beside
    sd[_RING], sd[_BESIDE], sd[_TIP] = ring_sd_m, math.sqrt(2.0) * beside, world.tip_radius_session_sd_m
    sd[_HEIGHT] = math.hypot(height_sd_m, world.indentation_session_sd_m)
    sd[_MODULUS] = math.hypot(world.modulus_batch_sd, world.modulus_specimen_sd, layer)
    sd[_FRICTION] = world.friction_mounting_sd
    sd[_ALONG] = math.hypot(world.bead_along_specimen_sd_m, world.bead_along_mounting_sd_m)
    return mean, sd
