"""``palp session people``: what sessions with people tell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import make_folder, note, print_json, print_text


def people(
    folders: Annotated[list[Path], argument("Folders of sessions.", "DIR...")],
    *,
    out: Annotated[Path | None, option("Folder for human.html, human.json and charts.")] = None,
    as_json: JsonOption = False,
) -> None:
    """With the power that such sessions have. Trials that were excluded or are to be done again do
    not count. Of simulated people, recordings and scripts no accuracy is ever given.
    """
    from palp_core.palpation.session.human.analysis import analyse, gather
    from palp_core.palpation.session.human.report import headline, write_human

    found = analyse(gather(folders))
    if as_json:
        print_json(found)
    else:
        print_text(headline(found))
        for mm, one in found.get("by_depth", {}).items():
            print_text(f"{mm} mm: {one['right']} of {one['of']}, {one['share']:.0%}")
    if out is not None:
        make_folder(out)
        write_human(folders, out)
        note(f"written: {out / 'human.html'}")
