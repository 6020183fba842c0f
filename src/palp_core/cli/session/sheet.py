"""``palp session new``, ``show``, and ``plan``: the sheet and the trials of a session."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import print_text, table_lines
from palp_core.cli.output import show as show_
from palp_core.counted import counted
from palp_core.errors import PalpError

if TYPE_CHECKING:
    from palp_core.palpation.session.sheet.sheet import SessionSheet


ByHandOption = Annotated[
    bool, option("A person palpates: a subject is named, and no torque sensor.", "--by-hand")
]


def new(
    file: Annotated[Path, argument("The sheet.", "[FILE]")] = Path("session.yaml"),
    phantoms: Annotated[
        str, option("Phantoms of the session; default: the paper's three.", metavar="FILE")
    ] = "",
    by_hand: ByHandOption = False,
    overwrite: Annotated[bool, option("A file that is there is replaced.", "--overwrite")] = False,
) -> None:
    from palp_core.palpation.session.sheet.of_run import phantom_codes
    from palp_core.palpation.session.sheet.sheet import template
    from palp_core.whole_file import write_whole

    try:
        write_whole(file, template(phantom_codes(phantoms), by_hand=by_hand), new=not overwrite)
    except FileExistsError as error:
        raise PalpError(
            f"{file} is there already, and nothing is overwritten unasked: --overwrite, or another name"
        ) from error
    look = f"palp session show {file}{' --by-hand' if by_hand else ''}"
    print_text(f"{file}: fill it in, look at it ({look}), and name it: session:={file}")


def show(
    path: Annotated[Path, argument("A session's folder, a bag, a sheet.", "DIR|BAG|FILE")],
    *,
    by_hand: ByHandOption = False,
    as_json: JsonOption = False,
) -> None:
    """Status 2: the sheet has mistakes."""
    from palp_core.palpation.session.sheet.of_run import sheet_lines

    sheet = _sheet_at(path, by_hand=by_hand)
    show_(sheet, table_lines(sheet_lines(sheet)), as_json=as_json)


def _sheet_at(path: Path, *, by_hand: bool) -> SessionSheet:
    from palp_core.graph.bag.reader import Bag
    from palp_core.palpation.session.bag_record import is_bag, launch_of
    from palp_core.palpation.session.run_note import read_note
    from palp_core.palpation.session.sheet.of_run import sheet_of
    from palp_core.palpation.session.sheet.sheet import read_sheet

    if is_bag(path):
        with Bag(path) as bag:
            found = sheet_of(launch_of(bag))
    elif path.is_dir():
        found = sheet_of(read_note(path))
    else:
        return read_sheet(path, by_hand=by_hand)
    if found is None:
        raise PalpError(f"{path}: was recorded without a sheet, by an earlier palp")
    return found


def plan(
    *,
    order: Annotated[
        Literal["paper", "counterbalanced"], option("Tables 3 and 4, or balanced over subjects.")
    ] = "paper",
    subject_number: Annotated[int, option("Of the subject in the study.", min=1)] = 1,
    seed: Annotated[int, option("Of the study.", min=0)] = 1,
    repeats: Annotated[int, option("Trials per phantom and phase.", min=1)] = 5,
    limit_s: Annotated[float, option("Longest time of a trial.")] = 60.0,
    rest_s: Annotated[float, option("Rest between trials.", min=0.0)] = 20.0,
    phantoms: Annotated[str, option("YAML file of phantoms; empty: the paper's three.")] = "",
    as_json: JsonOption = False,
) -> None:
    """No rig is needed."""
    from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
    from palp_core.palpation.session.human.plan import PHASES, HumanDesign, outline
    from palp_core.palpation.session.plan import PlannedPhantom

    depths_m = {code: one.bead.depth_m for code, one in load_phantoms(phantoms).items() if one.bead}
    found = outline(
        HumanDesign(
            phantoms=tuple(PlannedPhantom(code, depth_m) for code, depth_m in depths_m.items()),
            order=order,
            subject_number=subject_number,
            seed=seed,
            repeats=repeats,
            limit_s=limit_s,
            rest_s=rest_s,
        )
    )
    lines = []
    for phase in PHASES:
        trials = [trial for trial in found.trials if trial.phase == phase]
        counts = Counter(trial.phantom for trial in trials)
        given = ", ".join(f"{code} {counted(count, 'time')}" for code, count in sorted(counts.items()))
        table = [
            ("trial", *(str(trial.number) for trial in trials)),
            ("phantom", *(trial.phantom for trial in trials)),
            ("depth, mm", *(f"{depths_m[trial.phantom] * 1e3:g}" for trial in trials)),
        ]
        lines += [f"{phase}: {counted(len(trials), 'trial')}, {given}", *table_lines(table)]
    lines.append(
        f"{found.questions} questions, {found.mounts} changes of the phantom; "
        f"{found.shortest_s / 60:.0f} min without any palpation, {found.longest_s / 60:.0f} min at most"
    )
    show_(found, lines, as_json=as_json)
