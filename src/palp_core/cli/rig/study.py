"""``palp study``: the paper re-run, speed against accuracy, and where methods fail."""

import itertools
import shlex
from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import INTERRUPTED, JsonOption, argument, option
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text

app = typer.Typer()


@app.command("list")
def list_studies(*, as_json: JsonOption = False) -> None:
    """List the studies."""
    from palp_core.palpation.studies.catalogue import studies

    if as_json:
        print_json([{"name": one.name, "question": one.question} for one in studies().values()])
        return
    print_table([[one.name, one.question] for one in studies().values()])


def _names(incomplete: str) -> list[str]:
    """Names of studies, for the shell."""
    from palp_core.palpation.studies.catalogue import studies

    return [name for name in studies() if name.startswith(incomplete)]


@app.command("run")
def run(
    name: Annotated[str, argument("Name of the study; see `palp study list`.", complete=_names)],
    *,
    out: Annotated[Path, option("Folder for charts, tables and the page.")],
    quick: Annotated[bool, option("Few values: minutes instead of an hour.", "--quick")] = False,
    workers: Annotated[int, option("Local processes, where the study can use them.")] = 1,
    dask: Annotated[str, option("Dask scheduler instead, as tcp://host:8786.")] = "",
    sessions: Annotated[int, option("Most sessions of a case; 0: as many as published.")] = 0,
) -> None:
    """Run a study: charts, tables and a page.

    Ctrl-C ends it.
    """
    import palp_core
    from palp_core.graph.clock import local_time_name
    from palp_core.palpation.studies.catalogue import OPTIONS, study
    from palp_core.whole_file import write_json

    chosen = study(name)
    given = {"quick": quick, "workers": workers, "dask": dask, "sessions": sessions}
    options = {name: value for name, value in given.items() if value != OPTIONS[name]}
    make_folder(out)
    note(f"{chosen.name}: {chosen.question}")
    try:
        page = chosen.run(out, **options)
    except KeyboardInterrupt:
        note(f"{chosen.name} stopped; nothing is kept")
        raise typer.Exit(INTERRUPTED) from None
    flags = [[f"--{one}"] if value is True else [f"--{one}", str(value)] for one, value in options.items()]
    command = shlex.join(["palp", "study", "run", name, "--out", str(out), *itertools.chain(*flags)])
    date = local_time_name().partition("_")[0]
    made_by = {"name": name, "date": date, "command": command, "version": palp_core.__version__}
    write_json(out / "study.json", made_by | {"quick": quick})
    print_text(str(page))
