"""The scenes that the finite-element rungs are stated for."""

from __future__ import annotations

from palp_core.palpation.mechanics.limits import require
from palp_core.palpation.mechanics.phantom import Phantom


def require_range(phantom: Phantom, tip_radius_m: float) -> None:
    """Check a scene.

    Raises:
        OutOfRange: A quantity is outside the range; the message names it.
    """
    require("tip_radius_m", tip_radius_m, 0.002, 0.012, "use a ball of 2 to 12 mm")
    require("poisson", phantom.poisson, 0.3, 0.4999, "use 0.4999 for an incompressible gel, or l2")
    require("height_m", phantom.height_m, 0.015, 0.060, "use a slab of 15 to 60 mm, or l2")
    if phantom.bead is not None:
        require("depth_m", phantom.bead.depth_m, 0.0005, 0.015, "use 0.5 to 15 mm; leave out a deeper bead")
        require("bead_radius_m", phantom.bead.radius_m, 0.002, 0.012, "use a bead of 2 to 12 mm")
