"""What lies in a folder of sessions: each with who, when, its state, and what counts of it."""

from __future__ import annotations

import datetime
import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import last_set
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.session.audit import TrialKey, left_out
from palp_core.palpation.session.human.record import is_human_session, read_human
from palp_core.palpation.session.policy_changes import unplanned_spans
from palp_core.palpation.session.recorded_session import RecordedSession, RecordedTrial, read_session
from palp_core.palpation.session.result import how_far
from palp_core.palpation.session.roles import Roles, roles_of
from palp_core.palpation.session.run_note import STILL_RUNNING, read_note
from palp_core.palpation.session.session_folder import REPLACED, RUN, SWEEPS, TABLE
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.session.sheet.sheet import NONE, SessionSheet

PUBLISHED = "naive"
"""The filter that goes without saying."""

_OF_ONE = ("out", "key", "overwrite", "session", "seed", "host", "folder", "options", "stop_link", "verified")
"""Parameters that differ from session to session by nature."""

DICTIONARY_FILE = "dictionary.csv"
"""By which a folder of exported tables differs from a session's."""

State = Literal["whole", "unfinished", "running", "empty", "damaged", "person"]


@dataclass(frozen=True, eq=False)
class SessionEntry:
    """A session of a folder; sessions of one ``design`` are one group: policy, reading, depths, touch."""

    path: Path
    state: State
    words: str  # how far it came and why not further, or what is damaged
    began: (
        str  # local time of its launch, as 2026-11-22 21:05; of its last record, with ~, if that is unknown
    )
    sheet: SessionSheet | None = None
    seed: int = 0
    design: str = ""
    settings: dict[str, Any] = field(default_factory=dict)  # other parameters, by ``role.name``
    trials: tuple[RecordedTrial, ...] = ()  # of estimation, that came to a verdict and count
    excluded: dict[TrialKey, str] = field(default_factory=dict)
    digest: str = ""  # of its record; copies of a session have the same

    @property
    def subject(self) -> str:
        """Code of who was measured; ``none`` if no one was, or the sheet names none."""
        return self.sheet.subject if self.sheet is not None else NONE

    @property
    def who(self) -> str:
        """Subject, and operator where there is one."""
        if self.sheet is None:
            return "?"
        names = [name for name in (self.sheet.subject, self.sheet.operator) if name != NONE]
        return ", ".join(names) or ("simulated" if self.sheet.simulated else "no one")


def find_sessions(folder: Path) -> list[SessionEntry]:
    """Return every session below a folder, unfinished and damaged ones among them, by time."""
    if not folder.is_dir():
        raise PalpError(f"{folder}: no such folder")
    found = sorted(map(_entry, _folders(folder)), key=lambda one: (one.began.lstrip("~"), one.path))
    if not found:
        raise PalpError(f"{folder}: has no session: no folder below it with {RUN} or {TABLE}")
    return found


def sessions_below(path: Path) -> tuple[list[Path], list[dict[str, str]]]:
    """Return the sessions that a folder of sessions means: those that count, and why others do not.

    A session's own folder, a bag or a file means itself.
    """
    if not path.is_dir() or (path / TABLE).exists() or any(path.glob("*.mcap")):
        return [path], []
    entries, left = entries_that_count(find_sessions(path))
    return [entry.path for entry in entries], left


def entries_that_count(
    entries: Sequence[SessionEntry], *, unfinished: bool = False
) -> tuple[list[SessionEntry], list[dict[str, str]]]:
    """Return the sessions that count, and which do not, and why; ``unfinished`` ones count, too."""
    found: list[SessionEntry] = []
    left = []
    seen: dict[str, SessionEntry] = {}
    for entry in entries:
        why = ""
        if entry.state == "person":
            why = "with a person: palp session people analyses those"
        elif entry.state != "whole" and not (unfinished and entry.state == "unfinished"):
            why = entry.words
        elif entry.digest in seen:
            why = f"a copy of {seen[entry.digest].path}: a session counts once"
        elif not entry.trials:
            why = "all its trials are excluded" if entry.excluded else "has no trial of estimation that ended"
        if why:
            left.append({"path": str(entry.path), "why": why})
        else:
            seen[entry.digest] = entry
            found.append(entry)
    return found, left


def _folders(folder: Path) -> Iterator[Path]:
    """Yield the folders of sessions; links, as ``latest``, lead to what is there anyway."""
    for place, names, files in os.walk(folder):
        if DICTIONARY_FILE in files:  # tables that were exported
            names.clear()
        elif RUN in files or TABLE in files or SWEEPS in names:
            names.clear()
            yield Path(place)
        names[:] = sorted(name for name in names if name != REPLACED)


def _entry(folder: Path) -> SessionEntry:
    times = [(folder / name).stat().st_mtime for name in (TABLE, RUN) if (folder / name).exists()]
    began = f"~{datetime.datetime.fromtimestamp(max(times)).astimezone():%Y-%m-%d %H:%M}" if times else ""
    try:
        summary = read_note(folder)
        sheet = sheet_of(summary)
        if sheet is not None and sheet.began:
            day, _, time = sheet.began.partition("_")
            began = f"{day} {time.replace('-', ':')[:5]}"
        if is_human_session(folder):
            return _of_person(folder, summary, began)
        running = summary.exit_code < 0 and summary.ended == STILL_RUNNING
        if not (folder / TABLE).exists() and not running and not (folder / SWEEPS).exists():
            return SessionEntry(folder, "empty", "nothing was recorded", began, sheet)
        return _read(folder, summary, sheet, began, running=running)
    except PalpError as error:
        return SessionEntry(folder, "damaged", f"damaged: {error}", began)


def _of_person(folder: Path, summary: RunSummary, began: str) -> SessionEntry:
    """Return a session with a person, whose record is another one."""
    rows = read_human(folder)
    subjects = ", ".join(sorted({row.subject for row in rows})) or NONE
    end = "whole" if summary.exit_code == 0 else f"unfinished, because: {summary.ended}"
    sealed = sum(row.depth_m is None for row in rows)
    blinded = f", {sealed} of them blinded" if sealed else ""
    words = f"with a person, {counted(len(rows), 'trial')}{blinded}, {end}"
    sheet = SessionSheet(lab="", operator=NONE, subject=subjects)
    return SessionEntry(folder, "person", words, began, sheet, excluded=left_out(folder))


def _read(
    folder: Path, summary: RunSummary, sheet: SessionSheet | None, began: str, *, running: bool
) -> SessionEntry:
    session, roles = read_session(folder), roles_of(summary)
    for phase, number in sorted(set(session.left_out) - {(one.phase, one.trial) for one in session.rows}):
        raise PalpError(
            f"{folder}: {phase} trial {number} is excluded, and the record has none of that number"
        )
    far = how_far(session, summary, roles)
    state: State = "running" if running else "unfinished" if far else "whole"
    words = "whole" if far is None else f"{state}: {far.done} of {far.of} {far.what}"
    if far and not running and far.why:
        words += f", because: {far.why}"
    settings = {
        f"{role}.{name}": value
        for node, role in roles.of.items()
        for name, value in summary.params.get(node, {}).items()
        if name not in _OF_ONE and not isinstance(value, dict)
    }
    return SessionEntry(
        folder, state, words, began, sheet, summary.seed, _design(session, summary, roles), settings,
        session.trials, dict(session.left_out),
        hashlib.sha256((folder / TABLE).read_bytes()).hexdigest(),
    )  # fmt: skip


def _design(session: RecordedSession, summary: RunSummary, roles: Roles) -> str:
    """Return what sessions of one group have in common: policy, depths, what was touched and read."""
    experiment, estimator = roles.params("experiment"), roles.params("estimator")
    ring_mm = (roles.params("policy") | last_set(summary.changes, roles.node["policy"])).get("ring_mm")
    policy, swaps = str(experiment.get("policy") or "unnamed"), experiment.get("swaps") or ""
    found = policy + (f", then {swaps}" if swaps else "")
    for span in unplanned_spans(session.rows, policy, swaps):
        found += f", by hand {span.policy} from trial {span.trial}, palpation {span.palpation}"
    ring = f" at {ring_mm:g} mm" if ring_mm is not None else ""  # of the policy that was there last
    reading = estimator.get("reading", "feature")
    if estimator.get("filter", PUBLISHED) != PUBLISHED:
        reading += f", filter {estimator['filter']}"
    depths = ", ".join(f"{1e3 * one:g}" for one in session.depths_m)
    touch = f"world {roles.params('phantom').get('world', 'paper')}" if roles.touch_simulated else "the rig"
    return f"{found}{ring}; {reading}; {depths} mm; {touch}"
