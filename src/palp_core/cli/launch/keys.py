"""``palp keys``: this host's key pair, and who is let in."""

import re
import shlex
import socket
from typing import Annotated

import typer

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import note, print_text, show, table_lines

app = typer.Typer()


@app.command("generate")
def generate(
    *,
    name: Annotated[
        str | None, option("What others call this host; default: its name.", metavar="NAME")
    ] = None,
    force: Annotated[bool, option("Replace the pair that is there.", "--force")] = False,
) -> None:
    """Create this host's key pair.

    The secret stays here; hand the public file to other hosts.
    """
    from palp_core.graph.network.keys import KeyFolder

    keys = KeyFolder()
    own = keys.generate(
        name or re.sub(r"[^A-Za-z0-9_.-]", "_", socket.gethostname()).strip("_.-")[:63], force=force
    )
    file = keys.public_file(own)
    print_text(f"{file}")
    note(
        f"public key of '{own.name}': {own.public}\n"
        f"copy that file to the other host; there: palp keys allow {file.name}"
    )


@app.command("allow")
def allow(
    what: Annotated[str, argument("Public key file of a host, or its key, quoted.", "FILE_OR_KEY")],
    *,
    name: Annotated[str | None, option("Name for that host; default: its own.", metavar="NAME")] = None,
) -> None:
    """Admit the owner of a public key to running graphs."""
    from palp_core.graph.network.keys import KeyFolder

    name, key = KeyFolder().allow(what, name)
    print_text(f"allowed {name}: {key}")


@app.command("deny")
def deny(
    what: Annotated[str, argument("Who was let in, as `palp keys list` shows it.", "NAME_OR_KEY")],
) -> None:
    """Revoke a key; running graphs disconnect its nodes."""
    from palp_core.graph.network.keys import KeyFolder

    name, key = KeyFolder().deny(what)
    print_text(f"denied {name}: {key}")


@app.command("list")
def list_keys(*, as_json: JsonOption = False) -> None:
    """Show this host's public key and the admitted ones."""
    from palp_core.graph.network.keys import KeyFolder

    keys = KeyFolder()
    own, allowed, spoiled = keys.own(), keys.allowed(), keys.spoiled()
    lines = [f"no pair in {shlex.quote(str(keys.path))}; make one: palp keys generate"]
    if own is not None:
        lines = table_lines([("own", own.name, own.public)])
    show(
        {
            "folder": str(keys.path),
            "own": None if own is None else {"name": own.name, "public": own.public},
            "allowed": [{"name": name, "public": key} for name, key in allowed.items()],
            "spoiled": spoiled,
        },
        [*lines, *table_lines([("allowed", name, key) for name, key in allowed.items()])],
        as_json=as_json,
    )
    for name in () if as_json else spoiled:
        note(f"{keys.path / 'allowed' / name}.public contains no key; '{name}' is not allowed")
