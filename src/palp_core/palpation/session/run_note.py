"""``run.json``: which run a session's folder is of, so that its report can be made at any time.

The launcher writes the note when the run begins, and again with how it ended. Until the session has taken the
folder the note waits under another name: a session that is there already keeps its own.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from palp_core.counted import counted
from palp_core.errors import PalpError, in_words
from palp_core.palpation.session.roles import roles_of
from palp_core.palpation.session.session_folder import (
    CHECKPOINT,
    NEXT_RUN,
    OPENED,
    RUN,
    TABLE,
    cannot_write,
    is_being_written,
    refuse_input,
    refuse_occupied,
    restore_replaced,
)
from palp_core.whole_file import read_whole, write_json

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

STILL_RUNNING = "it is still running"
"""How a run ended that did not."""


def out_of(summary: RunSummary) -> Path:
    out = summary.args.get("out") or roles_of(summary).params("experiment").get("out")
    if not out:
        raise PalpError(
            f"{summary.file}: the run names no folder of a record; give the launch file an argument 'out' "
            "that the experiment records into"
        )
    if out.startswith("~"):
        raise PalpError(
            f"out:={out}: nothing replaces '~' there; write the folder out, as in out:=\"$HOME/x\""
        )
    return Path(out)


def refuse_run(summary: RunSummary) -> None:
    """Refuse a run that would write into the folder of another session, unless it is to replace that one."""
    folder = out_of(summary)
    if summary.resumed_count:
        refuse_resuming(folder)
    elif not roles_of(summary).params("experiment").get("overwrite"):
        others = "give this one another folder, out:=NAME, or let it replace that one, overwrite:=true"
        refuse_occupied(folder, ways_on(folder, others, _progress_words))
    for name, value in summary.args.items():
        if isinstance(value, str) and value and name != "out":
            refuse_input(folder, Path(value), f"'{name}:={value}'")


def ways_on(folder: Path, others: str, done: Callable[[Path], str]) -> str:
    """Return what to do about a folder that holds a session; one that is unfinished can go on."""
    if (folder / CHECKPOINT).exists():
        with contextlib.suppress(PalpError):
            return f"{unfinished_words(folder, done(folder))}. Or {others}"
    return others


def unfinished_words(folder: Path, done: str) -> str:
    """Return that a session is unfinished, how far it has come, and the command that goes on."""
    before = read_note(folder)
    given = [word for word in before.given if not word.startswith("out:=")]
    command = shlex.join(["palp", "launch", before.file, *given, f"out:={before.args.get('out', folder)}"])
    return f"it is unfinished, {done} done; `{command} --resume` goes on with it"


def _progress_words(folder: Path) -> str:
    from palp_core.palpation.session.trials_csv import read_rows

    rows = read_rows(folder)
    trials = sum(row.verdict not in ("", "continue") for row in rows)
    return f"{counted(len(rows), 'palpation')}" + (
        f" and {counted(trials, 'trial')} of estimation" if trials else ""
    )


def refuse_resuming(folder: Path, table: str = TABLE) -> None:
    """Refuse to go on with a session that is not there, or that goes on already."""
    if is_being_written(folder):
        raise PalpError(f"'{folder}' is in use by another run; choose another folder")
    if not (folder / table).exists():
        raise PalpError(f"'{folder}' has a checkpoint but no {table}: restore it, or use another folder")
    if (folder / OPENED).exists():
        raise PalpError(f"'{folder}' was unsealed, so it is not blind any more; begin in another folder")


def note_begin(summary: RunSummary) -> None:
    """Write the note that waits for the session to take its folder."""
    folder = out_of(summary)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / (RUN if summary.resumed_count else NEXT_RUN), summary)
    except OSError as error:
        raise cannot_write(folder, error) from error


def note_end(summary: RunSummary) -> bool:
    """Write how a run ended; return whether its session ever began: if not, nothing of the run stays."""
    folder = out_of(summary)
    if not folder.is_dir():
        raise PalpError(
            f"'{folder}' is gone; if it was renamed, `palp session report` makes the report where it is now"
        )
    (folder / NEXT_RUN).unlink(missing_ok=True)
    if summary.exit_code != 0 and not is_being_written(folder):
        restore_replaced(folder)
    if summary.exit_code != 0 and _run_of(folder) != summary.run:
        if not any(folder.iterdir()):
            folder.rmdir()
        return False
    write_json(folder / RUN, summary)
    return True


def read_note(folder: Path) -> RunSummary:
    """Return the run that a folder's session is of, as far as it is known how it went."""
    from palp_core.graph.launch.summary import RunSummary

    path = folder / RUN
    try:
        summary = msgspec.json.decode(read_whole(path), type=RunSummary)
    except FileNotFoundError as error:
        raise PalpError(f"not a session's folder: {path} is missing") from error
    except (OSError, msgspec.MsgspecError) as error:
        raise PalpError(f"{path} cannot be read: {in_words(error)}; restore it from a copy") from error
    if summary.exit_code < 0 and is_being_written(folder):
        return msgspec.structs.replace(summary, ended=STILL_RUNNING)
    return summary


def _run_of(folder: Path) -> str | None:
    try:
        return read_note(folder).run
    except PalpError:
        return None
