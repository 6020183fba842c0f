"""A blinded session with a person: in estimation codes hide which phantom is which, until it is unsealed.

Training goes by the phantoms' own codes, with their depths. Which code is which phantom is sealed in a key
(:mod:`palp_core.palpation.mechanics.scene.sealed`); the run keeps its digest, so that no other opens it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from palp_core.errors import PalpError
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.sealed import (
    digest_of,
    is_sealed,
    own_codes,
    seal,
    sealed_phantoms,
)
from palp_core.palpation.session.audit import WHOLE_SESSION, decide, decisions
from palp_core.palpation.session.human.record import (
    HUMAN_TABLE,
    RESULT,
    emg_without_row,
    human_table_text,
    read_human,
)
from palp_core.palpation.session.run_note import read_note
from palp_core.palpation.session.session_folder import CHECKPOINT, OPENED, is_being_written
from palp_core.whole_file import locked_path, read_whole, write_json, write_whole

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

KEY = "key.sealed"
DIGEST = "key.sha256"
"""Under this name a run keeps the digest of its key (``RunSummary.attached``)."""


def key_of(phantoms: str, key: str) -> str:
    """Return the path of a blinded session's key: its phantoms' file if that is one, or its own."""
    return phantoms if phantoms and is_sealed(phantoms) else key


def draw_key(summary: RunSummary) -> dict[str, str]:
    """Draw the key of a blinded run that is given none; return its digest as what the run is to keep."""
    asked = _blinded(summary)
    if asked is None:
        return {}
    path = key_of(asked["phantoms"], asked["key"])
    if not is_sealed(path):
        seal(Path(path), load_phantoms(asked["phantoms"]))
    return {DIGEST: digest_of(path)}


def refuse_other_key(summary: RunSummary, folder: Path) -> None:
    """Refuse to resume a blinded session whose key is gone or was changed: it would name other phantoms."""
    asked = _blinded(summary)
    if asked is None:
        return
    path = key_of(asked["phantoms"], asked["key"])
    if not is_sealed(path):
        raise PalpError(
            f"{path} is missing, and only it has the phantoms' codes; restore it, or use another folder"
        )
    _require_own(Path(path), read_note(folder))


def _blinded(summary: RunSummary) -> dict[str, Any] | None:
    """Return the parameters of a blinded run's node; None of a run in the open."""
    return next((one for one in summary.params.values() if one.get("blind") is True), None)


def _require_own(key: Path, summary: RunSummary) -> None:
    kept = summary.attached.get(DIGEST)
    if digest_of(key) != kept:
        why = "another session's key, or was changed" if kept else "none that the run knows of"
        raise PalpError(f"{key} is {why}: it opens nothing here; name the session's own with --key")


def unseal(folder: Path, reason: str, key: Path | None = None) -> list[tuple[str, str, float]]:
    """Write the table of a blinded session with depths; the one without stays, under another name.

    A run that is cut off leaves the table sealed, and the next one finishes. Return code, the phantom's own
    code, and depth in m.
    """
    _refuse_unfinished(folder)
    table = folder / HUMAN_TABLE
    if not table.exists():
        read_human(folder)  # it says what the folder is
    with locked_path(folder):  # the second finds what the first has written
        return _unseal(folder, reason, key or folder / KEY)


def _unseal(folder: Path, reason: str, key: Path) -> list[tuple[str, str, float]]:
    table = folder / HUMAN_TABLE
    rows = read_human(folder, whole=True)
    if not rows:
        raise PalpError(f"{table} has no rows")
    decided = any(one.deed == "unseal" for one in decisions(folder))
    begun = decided and not (folder / OPENED).exists()
    if all(row.depth_m is not None for row in rows) and not begun:
        raise PalpError(f"'{folder}' is not sealed; palp session report {folder} makes its report again")
    reported = json.loads(read_whole(folder / RESULT)) if (folder / RESULT).exists() else {}
    count = sum(sum(reported.get(name, {}).values()) for name in ("trials", "left_out"))
    if count > len(rows):
        raise PalpError(f"{table} has {len(rows)} of the {count} trials in {RESULT}; restore the table")
    if lost := emg_without_row(folder, rows):
        raise PalpError(
            f"{table} has no row of the trial {lost[0].relative_to(folder)}; restore the table, or move "
            "that file away if the trial was not over"
        )
    if not is_sealed(key):
        raise PalpError(f"{key} is not a sealed key; name the session's with --key")
    _require_own(key, read_note(folder))
    own = own_codes(key)
    depths_m = {code: one.bead.depth_m for code, one in sealed_phantoms(key).items() if one.bead is not None}
    for row in rows:
        if row.depth_m is None and row.phantom not in depths_m:
            raise PalpError(
                f"{table}: row {row.row}: no code '{row.phantom}' in {key}; restore the row, "
                "or name the session's key with --key"
            )
    opened = [
        row if row.depth_m is not None else msgspec.structs.replace(row, depth_m=depths_m[row.phantom])
        for row in rows
    ]
    if not sealed_name(table).exists():
        write_whole(sealed_name(table), read_whole(table))
    if not decided:  # before anything is open, and once
        decide(folder, WHOLE_SESSION, "unseal", reason)
    write_whole(table, human_table_text(opened))
    write_json(folder / OPENED, {code: {"depth_m": d, "phantom": own[code]} for code, d in depths_m.items()})
    return [(code, own[code], depth_m) for code, depth_m in sorted(depths_m.items())]


def sealed_name(path: Path) -> Path:
    """Return where a table without depths stays after its session was unsealed."""
    return path.with_suffix(f".sealed{path.suffix}")


def _refuse_unfinished(folder: Path) -> None:
    if is_being_written(folder):
        raise PalpError(f"'{folder}' is still being written: a session is unsealed when it is over")
    if (checkpoint := folder / CHECKPOINT).exists():
        raise PalpError(
            f"'{folder}' is unfinished, and an unsealed session cannot go on: finish it with palp launch "
            f"--resume, or remove {checkpoint} to end it here"
        )
