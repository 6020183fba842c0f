"""The sheet of a session with a person: which one a run was asked to take, and what it must say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from palp_core.errors import MechanicsError, PalpError
from palp_core.palpation.session.human.record import source_of
from palp_core.palpation.session.sheet.of_run import phantom_codes, with_software
from palp_core.palpation.session.sheet.sheet import NONE, SIMULATED, SessionSheet
from palp_core.palpation.session.sheet.sheet_file import read_sheet

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

LEADS = "HumanTrialDone"
"""The message type by which the node that leads a person is known."""


def asked_sheet(summary: RunSummary) -> SessionSheet:
    """Return the sheet that a run is given, or one of a simulated person where none is given."""
    asked = _leading(summary)
    source = source_of(asked.get("amplifier") or "", asked.get("host") or "")
    path, subject = asked.get("session") or "", asked.get("subject") or ""
    if path:
        found = read_sheet(path, _codes(asked), by_hand=True)
        if subject and subject != found.subject:
            raise PalpError(
                f"{path}: the sheet is of another subject than subject:= says; one of them is wrong"
            )
    elif source == "person":
        raise PalpError(
            f"{summary.file}: a session with a person needs its sheet: who, on whom, on what, which "
            "approval; palp session new FILE --by-hand writes one to fill in, and session:=FILE names it"
        )
    else:
        found = msgspec.structs.replace(SIMULATED, subject=subject or NONE)
    return with_software(found, simulated=source == "simulated")


def subject_of_sheet(path: str) -> str:
    """Return the subject that a sheet names; "" of no sheet."""
    return read_sheet(path, by_hand=True).subject if path else ""


def _leading(summary: RunSummary) -> dict[str, Any]:
    """Return the parameters of the node that leads the person."""
    for node, types in summary.publishes.items():
        if LEADS in types.values():
            return dict(summary.params.get(node, {}))
    raise PalpError(
        f"{summary.file}: no node publishes {LEADS}, so nobody leads a person; leave out 'report:'"
    )


def _codes(asked: dict[str, Any]) -> list[str]:
    try:
        return list(phantom_codes(asked.get("phantoms") or ""))
    except MechanicsError:  # told elsewhere, where it is named
        return []
