"""What searches are compared by: policies, rings, and what differs from what was trained."""

from __future__ import annotations

from dataclasses import replace

from palp_core.palpation.studies.search.rig import PEER, SearchCase
from palp_core.palpation.world.model import LAB
from palp_core.palpation.world.plane import PlanePrior

FIRST = 20_000
"""Number of the first phantom that is judged. Those from 1 to 999 were looked at while this was developed."""

FAST = {"speed_mm_s": 40.0, "hum_sd_n_mm": 0.0}
"""So fast that the tip slides without stick-slip, by the mechanics; gel that relaxes is not modelled."""

POLICIES = (
    SearchCase("greedy"),
    SearchCase("fixed", "fixed"),
    SearchCase(PEER, PEER),
    SearchCase("greedy, 40 mm/s", params=FAST),
    SearchCase("raster", "raster", {"most_s": 1e4}),
)
"""Compared on the same phantoms; the raster takes so long that few of them must do."""
FEW = "raster"

RINGS = tuple(
    SearchCase(f"rings of {words} mm", params={"rings_mm": rings})
    for words, rings in (("16", [16.0]), ("8 and 16", [8.0, 16.0]), ("4 to 16", [4.0, 8.0, 12.0, 16.0]))
)
"""Is it worth changing the stiffness while one searches?"""

_ONE, _NONE = PlanePrior(shares=(0.0, 1.0)), PlanePrior(shares=(1.0,))
_ROUGH = replace(LAB, name="rough", texture_sd_n_m=0.5e-3)


def _two(apart_m: float) -> SearchCase:
    prior = PlanePrior(shares=(0.0, 0.0, 1.0), apart_m=apart_m, farthest_m=apart_m + 1e-3)
    return SearchCase(f"two beads {1e3 * apart_m:g} mm apart", params={"second": 0.2}, prior=prior)


DIFFERENCES = (
    SearchCase("nothing", prior=_ONE),
    SearchCase("texture of 0.5 N mm, trained", params={"texture_sd_n_mm": 0.5}, prior=_ONE, world=_ROUGH),
    SearchCase("texture of 0.5 N mm", prior=_ONE, world=_ROUGH),
    SearchCase("texture of 0.5 N mm, no bead", prior=_NONE, world=_ROUGH),
    SearchCase("modulus +30 %", prior=_ONE, shift={"modulus": 0.3}),
    SearchCase("modulus -30 %", prior=_ONE, shift={"modulus": -0.3}),
    SearchCase("friction +20 %", prior=_ONE, shift={"friction": 0.2}),
    SearchCase("height +0.5 mm", prior=_ONE, shift={"height_m": 0.5e-3}),
    SearchCase("tilt of 1 mm over 100 mm", prior=_ONE, shift={"tilt_y": 0.01}),
    SearchCase("beads 9 to 10 mm deep", prior=replace(_ONE, depths_m=(0.009, 0.010))),
    SearchCase("bead of 10 mm", prior=_ONE, radius_m=0.005),
    *(_two(apart_m) for apart_m in (0.016, 0.025, 0.040)),
)
"""What phantoms may differ by; the searcher knows of it only where the name says so."""
