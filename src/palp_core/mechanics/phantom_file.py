"""Phantoms by code, from a YAML file.

::

    A: {modulus_pa: 20000.0, poisson: 0.49, height_m: 0.030, bead: {radius_m: 0.0075, depth_m: 0.002}}
    bare: {modulus_pa: 20000.0, poisson: 0.49, height_m: 0.030, bead: none}
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import yaml

from palp_core.errors import MechanicsError
from palp_core.mechanics.phantom import Bead, Phantom

__all__ = ["PAPER_PHANTOMS", "load_phantoms"]

PAPER_PHANTOMS = {
    code: Phantom(bead=Bead(depth_m=d)) for code, d in (("A", 0.002), ("B", 0.004), ("C", 0.008))
}
"""The published three: 30 mm of gel, a bead of 15 mm at 2, 4 and 8 mm."""


def load_phantoms(path: str) -> dict[str, Phantom]:
    """Return the phantoms of a file by code, in its order; the paper's three for an empty path.

    Raises:
        MechanicsError: No such file, no YAML, an unknown key or a value out of range; the message says where.
    """
    if not path:
        return dict(PAPER_PHANTOMS)
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise MechanicsError(f"{path}: cannot read the phantoms: {error}") from error
    if not isinstance(content, dict) or not content:
        raise MechanicsError(f"{path}: give phantoms by code, as in 'A: {{bead: {{depth_m: 0.002}}}}'")
    return {str(code): _phantom(path, str(code), entry) for code, entry in content.items()}


def _phantom(path: str, code: str, entry: Any) -> Phantom:
    if not isinstance(entry, dict):
        raise MechanicsError(
            f"{path}: phantom '{code}' must be a mapping of modulus_pa, poisson, height_m, bead"
        )
    unknown = set(entry) - set(Phantom.__dataclass_fields__)
    bead = entry.get("bead")
    if isinstance(bead, dict):
        unknown |= {f"bead.{key}" for key in set(bead) - set(Bead.__dataclass_fields__)}
    if unknown:
        raise MechanicsError(f"{path}: phantom '{code}': unknown {', '.join(sorted(unknown))}")
    if bead == "none":
        entry = {**entry, "bead": None}
    try:
        return msgspec.convert(entry, Phantom)
    except msgspec.ValidationError as error:
        raise MechanicsError(f"{path}: phantom '{code}': {error}") from error
    except MechanicsError as error:
        raise MechanicsError(f"{path}: phantom '{code}': {error}") from error
