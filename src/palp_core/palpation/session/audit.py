"""What was decided about single trials after they were made: appended next to the record, never taken back.

::

    OUT/audit.csv    one line per decision: phase, trial, what, why, when, who

A trial is ``exclude``d, or is to be done again (``redo``): either way its numbers do not count any more. The
record itself stays as it was measured; an analysis asks :func:`left_out`. A session that still goes
on does what is marked ``redo`` again at its end, as another trial, and says so (``redone``).
"""

import csv
import datetime
import getpass
import io
from collections.abc import Collection
from pathlib import Path
from typing import Literal

import msgspec

from palp_core.errors import PalpError, in_words
from palp_core.palpation.reporting.table import csv_text
from palp_core.whole_file import append_whole, read_whole

AUDIT = "audit.csv"
LONGEST_REASON = 1000

Deed = Literal["redo", "redone", "exclude", "unseal"]

TrialKey = tuple[str, int]
"""A trial: its phase, and its number there, from 1."""

WHOLE_SESSION: TrialKey = ("", 0)
"""What a decision about the session as a whole names."""


class Decision(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the audit; ``phase`` is empty where it is about the session as a whole."""

    phase: str
    trial: int
    deed: Deed
    reason: str
    time: str
    user: str


def decide(folder: Path, key: TrialKey, deed: Deed, reason: str) -> Decision:
    words = " ".join(reason.split())
    if not words:
        raise PalpError("a decision about a trial needs its reason: --reason '...'")
    if not words.isprintable() or len(words) > LONGEST_REASON:
        raise PalpError(
            f"the reason has characters that cannot be printed, or more than {LONGEST_REASON}; write it in "
            "a sentence"
        )
    decisions(folder)  # what is appended to a damaged audit does not count
    now = datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds")
    phase, trial = key
    made = Decision(phase=phase, trial=trial, deed=deed, reason=words, time=now, user=getpass.getuser())
    path = folder / AUDIT
    try:
        line = csv_text(msgspec.structs.astuple(made))
        append_whole(path, line, heading=csv_text(Decision.__struct_fields__))
    except OSError as error:
        raise PalpError(f"{path} cannot be written: {error.strerror or error}") from error
    return made


def decisions(folder: Path) -> list[Decision]:
    path = folder / AUDIT
    try:
        text = read_whole(path).decode()
    except FileNotFoundError:
        return []
    except (OSError, UnicodeDecodeError) as error:
        raise PalpError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    lines = csv.DictReader(io.StringIO(text, newline=""))
    try:
        return [msgspec.convert(dict(cells), Decision, strict=False) for cells in lines]
    except (msgspec.ValidationError, csv.Error) as error:
        raise PalpError(f"{path}:{lines.line_num}: the line is damaged: {in_words(error)}") from error


def left_out(folder: Path) -> dict[TrialKey, str]:
    """Return why each trial that does not count does not, by phase and number."""
    found: dict[TrialKey, str] = {}
    for one in decisions(folder):
        key = one.phase, one.trial
        if one.deed == "redone":
            found[key] = f"{found.get(key, 'redo')}; done again {one.reason}"
        elif key != WHOLE_SESSION:
            found[key] = f"{one.deed}: {one.reason}"
    return found


def to_be_redone(folder: Path, known: Collection[TrialKey]) -> list[TrialKey]:
    """Return trials that are marked to be done again, in order, without the known ones."""
    found = decisions(folder)
    done = {(one.phase, one.trial) for one in found if one.deed == "redone"}
    marked = dict.fromkeys((one.phase, one.trial) for one in found if one.deed == "redo")
    return [key for key in marked if key not in done and key not in known]


def note_redone(folder: Path, key: TrialKey, number: int) -> None:
    """Append, once, as which trial another was done again."""
    if not any((one.phase, one.trial) == key and one.deed == "redone" for one in decisions(folder)):
        decide(folder, key, "redone", f"as trial {number}")
