"""``palp session report``: the report of a stored session, from its folder or a bag."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.output import print_text
from palp_core.errors import PalpError


def report(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="DIR|BAG", help="A session's folder, or a bag of its run (also one file of it)."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Of a bag: for record and report; default: BAG_report beside it.",
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Of a bag: a session that the folder holds already is replaced."),
    ] = False,
    charts: Annotated[
        bool, typer.Option("--charts", help="Keep each chart as PNG, SVG and CSV, too, in charts/.")
    ] = False,
) -> None:
    """Write result.json and report.html with all charts, from the session's rows and sweeps (human.json and
    human.html, of a session with a person). Of a bag the rows and sweeps are made first, from what the nodes
    said.
    """
    from palp_core.palpation.session.bag_record import is_bag, write_record
    from palp_core.palpation.session.human.record import is_human_session
    from palp_core.palpation.session.human.report import write_human
    from palp_core.palpation.session.report import write
    from palp_core.palpation.session.run_note import read_note
    from palp_core.palpation.session.sheet.of_run import sheet_of

    if is_bag(path):
        whole = path.resolve()
        folder = out or path.parent / f"{whole.name.removesuffix('.mcap')}_report"
        print_text(write(folder, write_record(path, folder, overwrite=overwrite), files=charts))
    elif out is not None or overwrite:
        raise PalpError(
            f"{path} is no bag: the report of a session's folder is made in it, without --out or --overwrite"
        )
    elif is_human_session(path):
        print_text(write_human([path], path, sheet_of(read_note(path)), charts=charts))
    else:
        print_text(write(path, read_note(path), files=charts))
