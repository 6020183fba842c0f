"""``palp session new`` and ``show``: the sheet of a session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import print_json, print_table, print_text
from palp_core.errors import PalpError

if TYPE_CHECKING:
    from palp_core.palpation.session.sheet.sheet import SessionSheet


ByHandOption = Annotated[
    bool, typer.Option("--by-hand", help="A person palpates: a subject is named, and no torque sensor.")
]


def new(
    file: Annotated[Path, typer.Argument(metavar="[FILE]", help="The sheet.")] = Path("session.yaml"),
    phantoms: Annotated[
        str, typer.Option(metavar="FILE", help="Phantoms of the session; default: the paper's three.")
    ] = "",
    by_hand: ByHandOption = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="A file that is there is replaced.")] = False,
) -> None:
    from palp_core.palpation.session.sheet.of_run import phantom_codes
    from palp_core.palpation.session.sheet.template import template
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
    path: Annotated[Path, typer.Argument(metavar="DIR|BAG|FILE", help="A session's folder, a bag, a sheet.")],
    *,
    by_hand: ByHandOption = False,
    as_json: JsonOption = False,
) -> None:
    """Status 2: the sheet has mistakes."""
    from palp_core.palpation.session.sheet.of_run import sheet_lines

    sheet = _sheet_at(path, by_hand=by_hand)
    if as_json:
        print_json(sheet)
    else:
        print_table(sheet_lines(sheet))


def _sheet_at(path: Path, *, by_hand: bool) -> SessionSheet:
    """Return the sheet of what a path leads to.

    Raises:
        PalpError: There is none, or it has mistakes.
    """
    from palp_core.graph.bag.reader import Bag
    from palp_core.palpation.session.bag_record import is_bag, launch_of
    from palp_core.palpation.session.run_note import read_note
    from palp_core.palpation.session.sheet.of_run import sheet_of
    from palp_core.palpation.session.sheet.sheet_file import read_sheet

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
