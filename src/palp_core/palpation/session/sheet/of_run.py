"""The sheet of a run: which one it was asked to take, and which one it took."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

import palp_core
from palp_core.errors import MechanicsError, PalpError
from palp_core.graph.clock import local_time_name
from palp_core.palpation.session.roles import roles_of
from palp_core.palpation.session.session_folder import SHEET
from palp_core.palpation.session.sheet.identity import source_of
from palp_core.palpation.session.sheet.sheet import (
    NONE,
    SIMULATED,
    SessionSheet,
    parse_copy,
    read_sheet,
    sheet_text,
)
from palp_core.whole_file import read_whole, write_whole

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

LEADS = "HumanTrialDone"
"""The message type by which the node that leads a person is known."""


def asked_sheet(summary: RunSummary) -> SessionSheet:
    """Return the sheet that a run of the rig is given, or the one of a simulated session."""
    roles = roles_of(summary)
    asked, found = roles.params("experiment"), SIMULATED
    if path := asked.get("session"):
        found = read_sheet(path, _codes(asked))
    elif summary.clock == "wall" and not roles.touch_simulated:
        raise PalpError(
            f"{summary.file}: a session on the rig needs its sheet: who, on whom, on what, which approval; "
            "palp session new FILE writes one to fill in, and session:=FILE names it"
        )
    return _with_software(found, simulated=roles.touch_simulated)


def asked_human_sheet(summary: RunSummary) -> SessionSheet:
    """Return the sheet that a run with a person is given, or one of a simulated person."""
    leading = (node for node, types in summary.publishes.items() if LEADS in types.values())
    node = next(leading, None)
    if node is None:
        raise PalpError(
            f"{summary.file}: no node publishes {LEADS}, so no node leads a person; leave out 'report:'"
        )
    asked = summary.params.get(node, {})
    source = source_of(asked.get("amplifier") or "", asked.get("host") or "")
    path, subject = asked.get("session") or "", asked.get("subject") or ""
    if path:
        found = read_sheet(path, _codes(asked), by_hand=True)
        if subject and subject != found.subject:
            raise PalpError(f"{path}: the sheet names another subject than subject:=; correct one of them")
    elif source == "person":
        raise PalpError(
            f"{summary.file}: a session with a person needs its sheet: who, on whom, on what, which "
            "approval; palp session new FILE --by-hand writes one to fill in, and session:=FILE names it"
        )
    else:
        found = msgspec.structs.replace(SIMULATED, subject=subject or NONE)
    return _with_software(found, simulated=source == "simulated")


def _with_software(sheet: SessionSheet, *, simulated: bool) -> SessionSheet:
    """Return a sheet with what palp finds: its own version, and whether anything real was touched."""
    software = {"palp": palp_core.__version__, "python": platform.python_version()}
    return msgspec.structs.replace(sheet, software=software, simulated=simulated)


def texts_to_keep(sheet: SessionSheet) -> dict[str, str]:
    """Return what is kept with all that is recorded of a run that begins now: its sheet, by file."""
    return {SHEET: sheet_text(msgspec.structs.replace(sheet, began=local_time_name()))}


def sheet_of(summary: RunSummary) -> SessionSheet | None:
    """Return the sheet that a run took; None where it took none."""
    text = summary.attached.get(SHEET)
    return None if text is None else parse_copy(text, f"the sheet of run '{summary.run or summary.file}'")


def phantom_codes(path: str) -> Sequence[str]:
    """Return the codes of a file of phantoms, plain or sealed; of the paper's three for an empty path."""
    from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
    from palp_core.palpation.mechanics.scene.sealed import is_sealed, own_codes

    if path and is_sealed(path):
        return sorted(own_codes(path))
    return [code for code, one in load_phantoms(path).items() if one.bead is not None]


def _codes(asked: dict[str, Any]) -> Sequence[str]:
    try:
        return phantom_codes(asked.get("phantoms") or "")
    except MechanicsError:  # reported elsewhere, where it is named
        return ()


def write_copy(summary: RunSummary, folder: Path) -> None:
    """Write the sheet of a run next to its session, for people; ``run.json`` has it for machines."""
    if text := summary.attached.get(SHEET):
        write_whole(folder / SHEET, text)


def refuse_own_sheet(folder: Path) -> None:
    """Refuse a folder in which a person put a sheet to fill in: the session's copy would take its place."""
    path = folder / SHEET
    try:
        own = path.exists() and b"\nbegan:" not in read_whole(path)
    except OSError:
        own = True
    if own:
        raise PalpError(
            f"{path} is a sheet that palp did not write, and the session's copy would take its place: keep "
            "it elsewhere, as next to the folder"
        )


def sheet_lines(sheet: SessionSheet) -> list[tuple[str, str]]:
    """Return a sheet as lines of name and value, without what it does not say."""
    lines = [(name, getattr(sheet, name)) for name in ("lab", "operator", "subject", "ethics")]
    for code, one in sheet.phantoms.items():
        made = f"{one.id}, batch {one.batch}, cured {one.cured} at {one.cure_temperature_c:g} °C"
        lines.append((f"phantom {code}", made))
    if sheet.sensor is not None:
        lines.append(("torque sensor", f"{sheet.sensor.serial}, bias {1e3 * sheet.sensor.bias_n_m:g} N mm"))
    lines += [
        ("touch", "simulated" if sheet.simulated else "real"),
        ("software", ", ".join(f"{name} {version}" for name, version in sheet.software.items())),
        ("began", sheet.began),
        ("note", sheet.note),
    ]
    return [(name, value) for name, value in lines if value]
