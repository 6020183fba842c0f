"""``palp session redo``, ``exclude``, ``seal`` and ``unseal``: decisions that are never taken back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import note, print_json, print_table, print_text, show, table_lines
from palp_core.errors import PalpError

if TYPE_CHECKING:
    from palp_core.palpation.session.audit import Deed, TrialKey


TrialArgument = Annotated[int, argument("Its number in its phase.", "TRIAL", min=1)]
FolderArgument = Annotated[Path, argument("The session's folder.", "DIR", show_default="results/latest")]
TrainingOption = Annotated[bool, option("A trial of training, not of estimation.", "--training")]
ReasonOption = Annotated[str, option("Why.", "--reason", show_default=False)]
LATEST = Path("results/latest")


def redo(
    trial: TrialArgument,
    folder: FolderArgument = LATEST,
    *,
    reason: ReasonOption,
    training: TrainingOption = False,
    as_json: JsonOption = False,
) -> None:
    """A session that goes on, or is resumed, does it again at its end, as another trial: that one counts."""
    _decide("redo", ("training" if training else "estimation", trial), folder, reason, as_json=as_json)


def exclude(
    trial: TrialArgument,
    folder: FolderArgument = LATEST,
    *,
    reason: ReasonOption,
    training: TrainingOption = False,
    as_json: JsonOption = False,
) -> None:
    """Nothing is deleted."""
    _decide("exclude", ("training" if training else "estimation", trial), folder, reason, as_json=as_json)


def _decide(deed: Deed, key: TrialKey, folder: Path, reason: str, *, as_json: bool) -> None:
    from palp_core.palpation.session.audit import AUDIT, decide
    from palp_core.palpation.session.human.record import is_human_session, read_human
    from palp_core.palpation.session.trials_csv import read_rows

    person = is_human_session(folder)
    phase, trial = key
    rows = read_human(folder) if person else read_rows(folder)
    known = {row.trial for row in rows if row.phase == phase}
    if trial not in known:
        last = f"there are {min(known)} to {max(known)}" if known else "there is none yet"
        raise PalpError(f"'{folder}' has no {phase} trial {trial}; {last}")
    made = decide(folder, key, deed, reason)
    if as_json:
        print_json(made)
        return
    print_text(f"{phase} trial {trial}: {deed}: {made.reason} ({folder / AUDIT})")
    if deed == "redo" and _goes_on(folder):
        note("a session that runs or resumes repeats it at the end, as another trial")
        return
    if deed == "redo":
        together = "palp session people" if person else "palp session list"
        note(
            "the session is over and does not repeat it; run another session (out:=NAME) and pool both "
            f"({together})"
        )
    note(f"the report is not updated yet: palp session report {folder}")


def _goes_on(folder: Path) -> bool:
    """Return whether a session has not come to its end: it is under way, or was interrupted."""
    from palp_core.palpation.session.run_note import read_note

    try:
        return read_note(folder).exit_code != 0
    except PalpError:  # it is unknown what run it was of
        return False


def seal(
    key: Annotated[Path, argument("The file that is written.", "KEY")],
    phantoms: Annotated[str, option("YAML file of phantoms; empty: the paper's three.")] = "",
) -> None:
    """Prints what to write on which sticker: once, here, and nowhere else. Then: blind:=true phantoms:=KEY"""
    from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
    from palp_core.palpation.mechanics.scene.sealed import seal as write_key

    given = write_key(key, load_phantoms(phantoms), new=True)
    print_table([["phantom", "sticker"], *sorted([own, code] for code, own in given.items())])
    note(f"sealed: {key}; show the lines above to no participant")


def unseal(
    folder: Annotated[Path, argument("The session's folder.", "DIR")],
    *,
    reason: Annotated[str, option("Why now.", show_default=False)],
    key: Annotated[Path | None, option("The key; default: DIR/key.sealed.")] = None,
    as_json: JsonOption = False,
) -> None:
    """The report is made, and the audit has when, why and by whom it was opened."""
    from palp_core.palpation.session.human.blinding import unseal as open_session
    from palp_core.palpation.session.human.report import write_human
    from palp_core.palpation.session.run_note import read_note
    from palp_core.palpation.session.sheet.of_run import sheet_of

    opened = open_session(folder, reason, key)
    headline = write_human([folder], folder, sheet_of(read_note(folder)))
    rows = [(code, own, f"{depth_m * 1e3:g}") for code, own, depth_m in opened]
    show(
        [{"code": code, "phantom": own, "depth_m": depth_m} for code, own, depth_m in opened],
        [*table_lines([("code", "phantom", "depth, mm"), *rows]), headline],
        as_json=as_json,
    )
