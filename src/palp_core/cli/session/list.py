"""``palp session list``: the sessions of a folder, one by one and pooled."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text


def list_sessions(
    folder: Annotated[Path, argument("A folder with sessions at any depth.", "DIR")],
    *,
    unfinished: Annotated[
        bool, option("Sessions that did not come to their end count, too.", "--unfinished")
    ] = False,
    out: Annotated[Path | None, option("Folder for page (HTML), tables (CSV) and JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Unfinished, running, damaged and empty sessions are listed in words; whole ones are pooled, without
    excluded trials. Status 1: none counts.
    """
    from palp_core.palpation.session.many.overview import find_sessions
    from palp_core.palpation.session.many.pooled import pool

    if out is not None:
        make_folder(out)
    entries = find_sessions(folder)
    record = pool(entries, unfinished=unfinished)
    if as_json:
        print_json(record)
    else:
        from palp_core.palpation.session.many.page import difference_rows, pooled_rows, remarks, rows_of

        print_table(rows_of(entries, folder))
        if record["groups"]:
            print_text("")
            print_table(pooled_rows(record))
        if record["differences"]:
            print_text("")
            print_table(difference_rows(record))
        print_text("")
        for words in remarks(record):
            print_text(words)
    if not record["groups"]:
        note("no session counts, so nothing is pooled")
        raise typer.Exit(1)
    if out is not None:
        from palp_core.palpation.session.many.page import write_pooled

        note(f"written: {write_pooled(record, entries, folder, out)}")
