"""``palp init``."""

import shlex
from pathlib import Path
from typing import Annotated

from palp_core.cli.options import argument, option
from palp_core.cli.output import print_text
from palp_core.counted import counted

RECORDED = "tests/golden/session.mcap"
"""What ``launch/replay.yaml`` of the rig plays, if it is given nothing else."""

_SHOWN = 3


def init(
    folder: Annotated[Path, argument("A new folder, or an empty one.", "DIR")],
    *,
    rig: Annotated[bool, option("With the whole rig in it, to be changed.", "--rig")] = False,
    minimal: Annotated[bool, option("Two files: a launch file and a node.", "--minimal")] = False,
) -> None:
    from palp_core.cli.workspace.templates import texts, write_new
    from palp_core.errors import GraphError
    from palp_core.graph.workspaces.underlays import underlay

    if rig and minimal:
        raise GraphError("--rig and --minimal: one or the other")
    _check_empty(folder)
    values = {"WORKSPACE": folder.resolve().name, "PACKAGES": '"nodes", "msgs", "tests"'}
    contents: dict[Path, str | bytes] = {}
    launch, first = "launch/demo.yaml", "nodes/average.py"
    if minimal:
        contents.update(texts("minimal", values))
        launch, first = "launch.yaml", "counter.py"
    else:
        contents.update(texts("common", values))
        contents.update(texts("rig" if rig else "default", values))
    if rig:
        source = underlay("rig").folder
        found = [path for part in ("nodes", "msgs", "launch") for path in sorted((source / part).rglob("*"))]
        for path in (*found, source / RECORDED):
            if path.is_file() and path.suffix != ".pyc":
                contents[path.relative_to(source)] = path.read_bytes()
        launch, first = "launch/sim.yaml trials:=2 training:=5 --compose", "nodes/policy_markov.py"
    write_new(folder, contents)
    print_text(f"{folder}: {counted(len(contents), 'file')}; look at {folder / first} first")
    go = "" if folder.resolve() == Path.cwd() else f"  cd {shlex.quote(str(folder))}\n"
    print_text(f"{go}  palp launch {launch}" + ("" if minimal else "\n  pytest"))


def _check_empty(folder: Path) -> None:
    from palp_core.errors import GraphError

    if folder.exists() and not folder.is_dir():
        raise GraphError(f"{folder} is a file; name a new folder")
    there = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    if there:
        more = ", ..." if len(there) > _SHOWN else ""
        raise GraphError(
            f"{folder} is not empty (it has {', '.join(there[:_SHOWN])}{more}); name a new folder"
        )
