"""What lies in a folder of sessions: each with who, when, its state in words, and what counts of it."""

from __future__ import annotations

import datetime
import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import last_set
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.session.audit import TrialKey, left_out
from palp_core.palpation.session.human.record import is_human_session, read_human
from palp_core.palpation.session.policy_changes import manual_swaps
from palp_core.palpation.session.recorded_session import RecordedSession, RecordedTrial, read_session
from palp_core.palpation.session.result_json import how_far
from palp_core.palpation.session.roles import Roles, roles_of
from palp_core.palpation.session.run_note import read_note
from palp_core.palpation.session.session_folder import REPLACED, RUN, SWEEPS, TABLE
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.session.sheet.sheet import NONE, SessionSheet

PUBLISHED = "naive"
"""The filter that goes without saying."""

_OF_ONE = ("out", "key", "overwrite", "session", "seed", "host", "folder", "options", "stop_link", "verified")

DICTIONARY_FILE = "dictionary.csv"
"""By which a folder of exported tables is told from a session's."""

State = Literal["whole", "unfinished", "running", "empty", "damaged", "person"]


@dataclass(frozen=True, eq=False)
class SessionEntry:
    """A session of a folder."""

    path: Path
    state: State
    words: str  # the same in words: how far it came and why not further, or what is damaged
    # local time of its launch, as ``2026-11-22 21:05``; of older sessions, when its record was written last,
    # with a ``~``
    began: str
    sheet: SessionSheet | None = None
    seed: int = 0
    # what sessions have in common that are one group: policy, reading, depths, what was touched
    design: str = ""
    # parameters by ``role.name``, but for those that differ from session to session by nature
    settings: dict[str, Any] = field(default_factory=dict)
    trials: tuple[RecordedTrial, ...] = ()  # trials of estimation that came to a verdict and count
    # why each trial that does not count does not, by phase and number
    excluded: dict[TrialKey, str] = field(default_factory=dict)
    digest: str = ""  # of its record; copies of a session have the same

    @property
    def who(self) -> str:
        """Subject, and operator where there is one."""
        if self.sheet is None:
            return "?"
        names = [name for name in (self.sheet.subject, self.sheet.operator) if name != NONE]
        return ", ".join(names) or ("simulated" if self.sheet.simulated else "nobody")


def find_sessions(folder: Path) -> list[SessionEntry]:
    """Return every session below a folder, unfinished and damaged ones among them, by time."""
    if not folder.is_dir():
        raise PalpError(f"{folder}: no such folder")
    found = sorted(map(_entry, _folders(folder)), key=lambda one: (one.began.lstrip("~"), one.path))
    if not found:
        raise PalpError(f"{folder}: has no session: no folder below it with {RUN} or {TABLE}")
    return found


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
    began = _written(folder)
    try:
        summary = read_note(folder)
        sheet = sheet_of(summary)
        if sheet is not None and sheet.began:
            began = _readable(sheet.began)
        if is_human_session(folder):
            return _of_person(folder, summary, began)
        running = summary.exit_code < 0 and summary.ended == "it is still running"
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
    unknown = sorted(set(session.left_out) - {(one.phase, one.trial) for one in session.rows})
    for phase, number in unknown:
        raise PalpError(
            f"{folder}: {phase} trial {number} is excluded, and the record has none of that number"
        )
    far = how_far(session, summary, roles)
    state: State = "running" if running else "unfinished" if far else "whole"
    words = "whole" if far is None else f"{state}: {far.done} of {far.of} {far.what}"
    if far and not running and far.why:
        words += f", because: {far.why}"
    return SessionEntry(
        folder, state, words, began, sheet, summary.seed, _design(session, summary, roles),
        _settings(summary, roles), session.trials,
        dict(session.left_out), hashlib.sha256((folder / TABLE).read_bytes()).hexdigest(),
    )  # fmt: skip


def _design(session: RecordedSession, summary: RunSummary, roles: Roles) -> str:
    """Return what sessions of one group have in common: policy, depths, what was touched and read."""
    experiment, given = roles.params("experiment"), last_set(summary.changes, roles.node["policy"])
    ring_mm = (roles.params("policy") | given).get("ring_mm")
    policy = str(experiment.get("policy") or "unnamed")
    ring = f" at {ring_mm:g} mm" if ring_mm is not None else ""  # of the policy that was there last
    swaps = f", then {experiment['swaps']}" if experiment.get("swaps") else ""
    for one in manual_swaps(session.rows, experiment.get("swaps") or ""):
        swaps += f", by hand {one.policy} from trial {one.trial}, palpation {one.palpation}"
    depths = ", ".join(f"{1e3 * one:g}" for one in session.depths_m)
    estimator = roles.params("estimator")
    reading = estimator.get("reading", "feature")
    if estimator.get("filter", PUBLISHED) != PUBLISHED:
        reading += f", filter {estimator['filter']}"
    touch = f"world {roles.params('phantom').get('world', 'paper')}" if roles.touch_simulated else "the rig"
    return f"{policy}{swaps}{ring}; {reading}; {depths} mm; {touch}"


def _settings(summary: RunSummary, roles: Roles) -> dict[str, Any]:
    """Return parameters by ``role.name``, but for those that differ from session to session by nature."""
    return {
        f"{role}.{name}": value
        for node, role in roles.of.items()
        for name, value in summary.params.get(node, {}).items()
        if name not in _OF_ONE and not isinstance(value, dict)
    }


def _written(folder: Path) -> str:
    """Return when a record was written last, for sessions that do not say when they began."""
    times = [(folder / name).stat().st_mtime for name in (TABLE, RUN) if (folder / name).exists()]
    if not times:
        return ""
    return "~" + datetime.datetime.fromtimestamp(max(times)).astimezone().strftime("%Y-%m-%d %H:%M")


def _readable(began: str) -> str:
    day, _, time = began.partition("_")
    return f"{day} {time.replace('-', ':')[:5]}"
