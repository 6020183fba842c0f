"""A session without what tells who it was: a copy whose sheet, result and report do not say it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from palp_core.errors import PalpError
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.session.audit import AUDIT, Decision, decisions
from palp_core.palpation.session.roles import roles_of
from palp_core.palpation.session.session_folder import (
    OWN_FILES,
    RUN,
    SHEET,
    SWEEPS,
    TABLE,
    cannot_write,
    refuse_occupied,
)
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.session.sheet.sheet import NONE, SessionSheet
from palp_core.palpation.session.sheet.sheet_file import sheet_text
from palp_core.whole_file import write_json

REDACTED = "redacted"
FIELDS = ("operator", "subject", "ethics", "note")
"""What a redacted sheet does not say, if nothing else is asked for."""

_COPIED = (TABLE, SWEEPS, "primitives.json", "noise.yaml", "repeatability.json")
_LEAST_LETTERS = 3  # a shorter word is found by chance


def redact(folder: Path, summary: RunSummary, out: Path, fields: Sequence[str] = FIELDS) -> RunSummary:
    """Copy a session, without its report and without what its sheet says of people.

    Args:
        folder: Of the session.
        summary: How its run went.
        out: For the copy; made if missing.
        fields: Of the sheet: each becomes ``redacted``.

    Returns:
        How the run went, as the copy's ``run.json`` says it: its report is still to be made.
    """
    sheet = sheet_of(summary)
    if sheet is None:
        raise PalpError(f"{folder}: has no sheet: nothing tells who it was")
    told = redacted_sheet(sheet, fields)
    refuse_occupied(out, "name another folder, --out NAME", "--out")
    found = _without_places(summary, out, sheet_text(told))
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in _COPIED:
            if (folder / name).is_dir():
                shutil.copytree(folder / name, out / name, dirs_exist_ok=True)
            elif (folder / name).exists():
                shutil.copyfile(folder / name, out / name)
        _copy_decisions(folder, out)
        write_json(out / RUN, found)
    except OSError as error:
        raise cannot_write(out, error, "--out") from error
    return found


def redacted_sheet(sheet: SessionSheet, fields: Sequence[str]) -> SessionSheet:
    """Return a sheet in which each of the fields is ``redacted``."""
    texts = [name for name, value in msgspec.to_builtins(sheet).items() if isinstance(value, str)]
    if unknown := [name for name in fields if name not in texts]:
        raise PalpError(f"the sheet has no text '{unknown[0]}'; there are {', '.join(texts)}")
    return msgspec.structs.replace(sheet, **{name: REDACTED for name in fields if getattr(sheet, name)})


def _copy_decisions(folder: Path, out: Path) -> None:
    """Copy what was decided about trials, without who decided it."""
    made = decisions(folder)
    if made:
        rows = [msgspec.structs.astuple(msgspec.structs.replace(one, user=REDACTED)) for one in made]
        write_csv(out / AUDIT, Decision.__struct_fields__, rows)


def left_out(folder: Path) -> list[str]:
    """Return the names of what lies in a session's folder and is no part of the session: it is not copied."""
    return sorted(path.name for path in folder.iterdir() if path.name not in (*OWN_FILES, AUDIT))


def _without_places(summary: RunSummary, out: Path, text: str) -> RunSummary:
    """Return a summary with another sheet, whose files are not named: paths tell of people, too."""
    node = roles_of(summary).node["experiment"]
    args = {name: value for name, value in summary.args.items() if name != "session"}
    params = {name: dict(values) for name, values in summary.params.items()}
    if "session" in params[node]:
        params[node]["session"] = ""
    for values in (args, params[node]):
        if "out" in values:
            values["out"] = str(out)
    given = [word for word in summary.given if word.partition(":=")[0] not in ("session", "out")]
    return msgspec.structs.replace(
        summary,
        args=args,
        given=[*given, f"out:={out}"],
        params=params,
        file=Path(summary.file).name,
        attached={SHEET: text},
    )


def still_told(out: Path, sheet: SessionSheet, fields: Sequence[str] = FIELDS) -> Iterator[str]:
    """Yield which files of a redacted session still have a word that it was not to have, and which word.

    Args:
        out: The copy with its report.
        sheet: As it was.
        fields: What was taken out.
    """
    words = [str(getattr(sheet, name)) for name in fields]
    sought = [word for word in words if word != NONE and len(word) >= _LEAST_LETTERS]
    for path in sorted(out.rglob("*")):
        if path.suffix not in (".csv", ".json", ".yaml", ".html", ".svg"):
            continue
        text = re.sub(r"base64,[\w+/=]+", "", path.read_text(encoding="utf-8", errors="replace"))
        for word in sought:
            if re.search(rf"(?<!\w){re.escape(word)}(?!\w)", text):
                yield f"{path.relative_to(out)} still has '{word}'"
