"""Phantoms by code, from a YAML file; each as under ``phantom`` in a scene.

::

    A: {modulus_pa: 20000.0, poisson: 0.49, height_m: 0.030, bead: {radius_m: 0.0075, depth_m: 0.002}}
    bare: {modulus_pa: 20000.0, poisson: 0.49, height_m: 0.030, bead: none}
"""

import dataclasses

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.scene.file import build, read_mapping
from palp_core.palpation.mechanics.scene.sealed import is_sealed

PAPER_PHANTOMS = {
    code: Phantom(bead=Bead(depth_m=d)) for code, d in (("A", 0.002), ("B", 0.004), ("C", 0.008))
}
"""The published three: 30 mm of gel, a bead of 15 mm at 2, 4 and 8 mm."""

CASTINGS, CAST_COUNT = "castings", 6
"""Name of a set, and how often each of the published three is cast for it: A1 to A6, B1 to B6, C1 to C6."""


def load_phantoms(path: str, gel: Phantom | None = None) -> dict[str, Phantom]:
    """Return the phantoms of a file by code."""
    if path and is_sealed(path):
        raise MechanicsError(
            f"{path} is sealed: reading it would unblind the session; run a blinded session "
            "with a person with it (launch/human.yaml blind:=true), or give the file that it was made from"
        )
    if path not in ("", CASTINGS):
        root = read_mapping(path, "phantoms")
        entries = root.items("the file of phantoms")
        if not entries:
            raise root.error("give phantoms by code, as in 'A: {bead: {depth_m: 0.002}}'")
        return {code: build(Phantom, entry, f"phantom '{code}'") for code, entry in entries.items()}
    three = dict(PAPER_PHANTOMS)
    if gel is not None:
        three = {
            code: dataclasses.replace(
                gel, bead=dataclasses.replace(gel.bead or paper.bead, depth_m=paper.bead.depth_m)
            )
            for code, paper in PAPER_PHANTOMS.items()
            if paper.bead is not None
        }
    if not path:
        return three
    return {f"{code}{n}": one for code, one in three.items() for n in range(1, CAST_COUNT + 1)}
