"""Unsealing a blinded session: the record with depths takes its place beside the one with codes."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import PalpError
from palp_core.palpation.mechanics.scene.sealed import is_sealed, own_codes, sealed_phantoms, standing
from palp_core.palpation.session.decided.audit import WHOLE_SESSION, decide
from palp_core.palpation.session.decided.blind import KEY, is_blinded
from palp_core.palpation.session.human.record import HUMAN_TABLE, human_table_text, read_human
from palp_core.palpation.session.session_folder import CHECKPOINT, OPENED, TABLE, is_being_written
from palp_core.palpation.session.trials_csv import Row, read_rows, table_text
from palp_core.whole_file import read_whole, write_json, write_whole

_PRIMITIVES = "primitives.json"
_BY_DEPTH = ("depths_m", "mean", "sd", "count")


@dataclass(frozen=True)
class OpenedKey:
    """Who is who.

    Attributes:
        depths_m: True depth by code.
        standing_m: What stood for it, by code.
        own: The phantom's own code by the session's.
    """

    depths_m: dict[str, float]
    standing_m: dict[str, float]
    own: dict[str, str]

    @property
    def order(self) -> list[int]:
        """Places of the sealed classes, the shallowest first."""
        codes = sorted(self.standing_m)
        return sorted(range(len(codes)), key=lambda place: self.depths_m[codes[place]])

    def depth_m(self, stands_m: float) -> float:
        """Return the depth for which a number stands."""
        return next(self.depths_m[code] for code, s in self.standing_m.items() if abs(s - stands_m) < 1e-9)


def open_key(path: Path) -> OpenedKey:
    """Return who is who.

    Raises:
        PalpError: It is no key, or cannot be read.
    """
    if not is_sealed(path):
        raise PalpError(f"{path} is no sealed key; name the session's with --key")
    beads = {code: one.bead for code, one in sealed_phantoms(path).items()}
    depths_m = {code: bead.depth_m for code, bead in beads.items() if bead is not None}
    return OpenedKey(depths_m, standing(path), own_codes(path))


def unseal(folder: Path, reason: str, key: Path | None = None) -> OpenedKey:
    """Write the record of a session with depths for codes; the one with codes stays beside it.

    Args:
        folder: Of the session.
        reason: Why now; it is written into the audit.
        key: The key; None: the folder's own.

    Raises:
        PalpError: It is not blinded, still under way, or of another key; nothing was changed then.
    """
    _refuse_unfinished(folder)
    rows = read_rows(folder)
    if not is_blinded(rows):
        raise PalpError(f"'{folder}' is not sealed")
    opened = open_key(key or folder / KEY)
    for row in rows:
        if abs(opened.standing_m.get(row.phantom, -1.0) - row.depth_m) > 1e-9:
            raise PalpError(
                f"'{folder}': row {row.row} is of phantom {row.phantom}: this is another session's key"
            )
    texts = {}
    if (folder / _PRIMITIVES).exists():
        kept = sealed_name(folder / _PRIMITIVES)
        learnt = json.loads(read_whole(kept if kept.exists() else folder / _PRIMITIVES))
        texts[_PRIMITIVES] = json.dumps(_learnt(learnt, opened), indent=1) + "\n"
    texts[TABLE] = table_text([_told(row, opened) for row in rows], sorted(opened.depths_m.values()))
    _open_files(folder, opened, reason, texts)
    return opened


def unseal_by_hand(folder: Path, reason: str, key: Path | None = None) -> OpenedKey:
    """Write the table of a blinded session with a person with depths; the other one stays beside it.

    The arguments are those of :func:`unseal`.

    Raises:
        PalpError: It is not blinded, still under way, or of another key; nothing was changed then.
    """
    _refuse_unfinished(folder)
    rows = read_human(folder)
    if all(row.depth_m is not None for row in rows):
        raise PalpError(f"'{folder}' is not sealed")
    opened = open_key(key or folder / KEY)
    for row in rows:
        if row.depth_m is None and row.phantom not in opened.depths_m:
            raise PalpError(
                f"'{folder}': row {row.row} is of phantom {row.phantom}: this is another session's key"
            )
    told = [
        row if row.depth_m is not None else msgspec.structs.replace(row, depth_m=opened.depths_m[row.phantom])
        for row in rows
    ]
    _open_files(folder, opened, reason, {HUMAN_TABLE: human_table_text(told)})
    return opened


def sealed_name(path: Path) -> Path:
    """Return where a file with codes stays after its session was unsealed."""
    return path.with_suffix(f".sealed{path.suffix}")


def _refuse_unfinished(folder: Path) -> None:
    if is_being_written(folder):
        raise PalpError(f"'{folder}' is still being written: a session is unsealed when it is over")
    if (checkpoint := folder / CHECKPOINT).exists():
        raise PalpError(
            f"'{folder}' is unfinished, and an unsealed session cannot go on: finish it with palp launch "
            f"--resume, or remove {checkpoint} to end it here"
        )


def _open_files(folder: Path, opened: OpenedKey, reason: str, texts: Mapping[str, str]) -> None:
    """Keep the files with codes under other names, then replace them, the table last.

    A run that is cut off leaves the table sealed; the next one finishes.
    """
    decide(folder, WHOLE_SESSION, "unseal", reason)
    for path in (folder / name for name in texts):
        if not sealed_name(path).exists():
            write_whole(sealed_name(path), read_whole(path))
    write_json(
        folder / OPENED,
        {code: {"depth_m": d, "phantom": opened.own[code]} for code, d in opened.depths_m.items()},
    )
    for name, text in texts.items():
        write_whole(folder / name, text)


def _told(row: Row, opened: OpenedKey) -> Row:
    return msgspec.structs.replace(
        row,
        depth_m=opened.depth_m(row.depth_m),
        estimate_m=None if row.estimate_m is None else opened.depth_m(row.estimate_m),
        posterior=[row.posterior[place] for place in opened.order] if row.posterior else [],
        gain=[row.gain[place] for place in opened.order] if row.gain else [],
    )


def _learnt(learnt: dict[str, Any], opened: OpenedKey) -> dict[str, Any]:
    """Return what training taught, a row per depth, in the order of the depths."""
    stood = [opened.depth_m(one) for one in learnt["depths_m"]]
    order = sorted(range(len(stood)), key=stood.__getitem__)
    return (
        learnt
        | {"depths_m": sorted(stood)}
        | {name: [learnt[name][place] for place in order] for name in _BY_DEPTH[1:]}
    )
