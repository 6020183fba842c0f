"""``palp report``: the report of a stored session, made again."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.output import print_text


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A session's folder.")],
) -> None:
    """Make the report of a stored session, whole or cut short.

    That is result.json, report.html and charts/, from the session's rows and sweeps.
    """
    from palp_core.palpation.session.report import write
    from palp_core.palpation.session.run_note import read_note

    print_text(write(folder, read_note(folder)))
