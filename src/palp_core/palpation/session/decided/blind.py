"""A blinded session: codes instead of depths in all that it says and writes, until it is unsealed.

The phantoms get new codes (:mod:`palp_core.palpation.mechanics.scene.sealed`). Who simulates a phantom reads
from the key what it touches; everybody else is told, in a depth's place, a number that stands for the code.
What is measured is measured: whoever knows how a deeper nodule feels may guess from the torque.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec

from palp_core.errors import MechanicsError, PalpError
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.sealed import (
    is_sealed,
    seal,
    sealed_mistake,
    standing,
)
from palp_core.sealing import stands_for_a_depth

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

KEY = "key.sealed"


class Blindable(Protocol):
    """Parameters of a node that may be blinded."""

    @property
    def phantoms(self) -> str:
        """File of phantoms, plain or sealed."""

    @property
    def blind(self) -> bool:
        """Whether codes stand for depths."""

    @property
    def key(self) -> str:
        """Where the key is, or is to be drawn."""


class OfADepth(Protocol):
    """What is recorded of one depth: a row, a sweep."""

    @property
    def depth_m(self) -> float | None:
        """The depth, or what stands for it; None where nobody told."""


def phantoms_file(params: Blindable) -> str:
    """Return the file that the phantoms are read from; draw the key of a blinded session if nobody has.

    Whichever node is first draws it; all others find it there.

    Raises:
        MechanicsError: The phantoms cannot be blinded, or the key cannot be written.
    """
    if not params.blind or is_sealed(params.phantoms):
        return params.phantoms
    if not params.key:
        raise MechanicsError("a blinded session needs a place for its key")
    if not is_sealed(params.key):
        scene = getattr(params, "scene", "")
        gel = read_scene(scene).phantom if scene else None
        seal(Path(params.key), load_phantoms(params.phantoms, gel))
    return params.key


def shown_depths(params: Blindable) -> dict[str, float]:
    """Return the depth of each phantom with a bead by code, as it may be shown: m, or what stands for it."""
    path = phantoms_file(params)
    if params.blind:
        return standing(path)
    return {code: one.bead.depth_m for code, one in load_phantoms(path).items() if one.bead is not None}


def shown_depth(params: Blindable, code: str, depth_m: float) -> float:
    """Return a mounted phantom's depth as it may be shown, m, or what stands for it."""
    return standing(phantoms_file(params))[code] if params.blind else depth_m


def blind_mistakes(params: Blindable) -> dict[str, str]:
    """Return why a session cannot be blinded, or has to be, by parameter; nothing is drawn."""
    if not params.blind:
        why = sealed_mistake(params.phantoms) if params.phantoms else None
        return {"phantoms": why} if why else {}
    try:
        if not is_sealed(params.phantoms):
            found = load_phantoms(params.phantoms)
            depths = [one.bead.depth_m for one in found.values() if one.bead is not None]
            if len(set(depths)) < max(2, len(found)):
                why = "a blinded session needs two phantoms with a bead at least, and no two of one depth"
                return {"phantoms": why}
    except MechanicsError as error:
        return {"phantoms": str(error)}
    return {}


def is_blinded(rows: Iterable[OfADepth]) -> bool:
    """Tell whether codes stand for depths in the rows of a record."""
    return any(row.depth_m is not None and stands_for_a_depth(row.depth_m) for row in rows)


def ran_blinded(summary: RunSummary) -> bool:
    """Tell whether a node of a run was blinded: a record that has no row yet tells nothing."""
    return any(one.get("blind") is True for one in summary.params.values())


def refuse_blinded(rows: Iterable[OfADepth], where: Path) -> None:
    """Refuse what would tell how a blinded session went.

    Raises:
        PalpError: It is blinded.
    """
    if is_blinded(rows):
        raise still_blinded(where)


def still_blinded(where: Path) -> PalpError:
    """Return what to say to whoever asks too early."""
    return PalpError(
        f"'{where}' is a blinded session: codes stand for depths, and nobody is to know how it went; "
        "when all is done: palp session unseal"
    )


def opened_run(summary: RunSummary, folder: Path) -> RunSummary:
    """Return how a run went with the opened key for the file of phantoms, by whose codes its record goes."""
    params = summary.params
    keys = {
        node: one.get("phantoms") for node, one in params.items() if one.get("blind") and "phantoms" in one
    }
    if not keys:
        return summary
    given = next((path for path in keys.values() if path and is_sealed(path)), "")
    path = given or str(folder / KEY)
    told = {node: one | ({"phantoms": path} if node in keys else {}) for node, one in params.items()}
    return msgspec.structs.replace(summary, params=told)
