"""``palp session seal`` and ``unseal``: the beginning and the end of a blinded session with a person."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import note, print_json, print_table, print_text


def seal(
    key: Annotated[Path, typer.Argument(metavar="KEY", help="The file that is written.", show_default=False)],
    phantoms: Annotated[str, typer.Option(help="YAML file of phantoms; empty: the paper's three.")] = "",
) -> None:
    """Tells what to write on which sticker: once, here, and nowhere else. Then: blind:=true phantoms:=KEY"""
    from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
    from palp_core.palpation.mechanics.scene.sealed import seal as write_key

    given = write_key(key, load_phantoms(phantoms), new=True)
    print_table([["phantom", "sticker"], *sorted([own, code] for code, own in given.items())])
    note(f"sealed: {key}; whoever takes part in the session must not see the lines above")


def unseal(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The session's folder.", show_default=False)],
    *,
    reason: Annotated[str, typer.Option("--reason", help="Why now, in words.", show_default=False)],
    key: Annotated[Path | None, typer.Option(help="The key; default: DIR/key.sealed.")] = None,
    as_json: JsonOption = False,
) -> None:
    """The report is made, and the audit says when, why and by whom it was opened."""
    from palp_core.palpation.session.human.blinding import unseal as open_session
    from palp_core.palpation.session.human.report import write_human
    from palp_core.palpation.session.run_note import read_note
    from palp_core.palpation.session.sheet.of_run import sheet_of

    opened = open_session(folder, reason, key)
    said = write_human([folder], folder, sheet_of(read_note(folder)))
    if as_json:
        print_json([{"code": code, "phantom": own, "depth_m": depth_m} for code, own, depth_m in opened])
        return
    rows = [[code, own, f"{depth_m * 1e3:g}"] for code, own, depth_m in opened]
    print_table([["code", "phantom", "depth, mm"], *rows])
    print_text(said)
