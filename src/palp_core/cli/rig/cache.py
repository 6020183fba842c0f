"""``palp cache``: the expensive set-ups of contact models that are kept on disk."""

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import print_json, print_text

app = typer.Typer(help="Set-ups of contact models, kept on disk.", no_args_is_help=True)


@app.command("info")
def info(*, as_json: JsonOption = False) -> None:
    """Say where the cache is and what it holds."""
    from palp_core.palpation.mechanics.contact import cache

    found = cache.info()
    if as_json:
        print_json({"path": str(found.path), "entries": found.entry_count, "size_bytes": found.size_bytes})
        return
    print_text(f"{found.path}: {found.entry_count} set-ups, {found.size_bytes / 1e6:.1f} MB")


@app.command("clear")
def clear(*, as_json: JsonOption = False) -> None:
    """Remove every set-up; what is needed again is computed again."""
    from palp_core.palpation.mechanics.contact import cache

    count = cache.clear()
    if as_json:
        print_json({"removed": count})
        return
    print_text(f"{count} set-ups removed")
