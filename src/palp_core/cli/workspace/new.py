"""``palp new``: a file of one's own, with its test, in the workspace that one is in."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from palp_core.cli.options import argument, option
from palp_core.cli.output import note, print_text

if TYPE_CHECKING:
    from palp_core.cli.workspace.templates import Named

app = typer.Typer()

NameArgument = Annotated[str, argument("As in grip_force, or GripForce.", "NAME")]


@app.command()
def node(name: NameArgument) -> None:
    """Write nodes/NAME.py and its test."""
    new = _named(name)
    _write(f"nodes/{new.module}.py", f"test_{new.module}.py", "node", new)
    print_text(
        f"into a launch file, under nodes:\n  {new.module}:\n    run: nodes.{new.module}:{new.class_name}\n"
        f"    inputs: {{heard: NODE/progress}}"
    )


@app.command()
def message(name: NameArgument) -> None:
    """Write msgs/NAME.py and its test."""
    new = _named(name)
    _write(f"msgs/{new.module}.py", f"test_{new.module}_message.py", "message", new)
    print_text(f"in a node: from msgs.{new.module} import {new.class_name}")


@app.command()
def policy(name: NameArgument) -> None:
    """Write nodes/policy_NAME.py, a policy of the rig."""
    new = _named(name.removeprefix("policy_"))
    module = f"policy_{new.module}"
    _write(f"nodes/{module}.py", f"test_{module}.py", "policy", new)
    print_text(
        f"from the first palpation on: palp launch rig:sim.yaml policy:=nodes.{module}:{new.class_name} "
        "trials:=2 training:=3 --compose\n"
        f"in a run: palp swap policy nodes.{module}:{new.class_name}"
    )


@app.command()
def driver(
    name: NameArgument,
    *,
    kind: Annotated[
        Literal["stage", "ring", "torque", "emg"], option("What the device is.", show_default=False)
    ],
) -> None:
    """Write drivers/NAME.py, a driver, and its test."""
    new = _named(name)
    _write(f"drivers/{new.module}.py", f"test_{new.module}_driver.py", f"driver_{kind}", new, kind)
    run = f"drivers.{new.module}:{new.class_name}"
    print_text(f"in a launch file, of the node of that device: device: {run}")
    if kind == "stage":
        print_text(
            f"in the rig, which must be told what stops it: palp launch rig:rig.yaml stage_device:={run} "
            "safety:stop_link:=none 'safety:options:={}' 'stage:options:={}'"
        )


def _named(name: str) -> Named:
    from palp_core.cli.workspace.templates import named

    return named(name)


def _tests_of(workspace: Path, package: str) -> Path:
    """Return where a workspace keeps the tests of its nodes, messages or drivers, from the workspace.

    It is a folder of the package's name in the first folder that pytest is told to look in, or that folder.
    """
    settings = {}
    if (workspace / "pyproject.toml").is_file():
        settings = tomllib.loads((workspace / "pyproject.toml").read_text(encoding="utf-8"))
    pytest = settings.get("tool", {}).get("pytest", {}).get("ini_options", {})
    folders = pytest.get("testpaths", "tests")
    tests = Path(folders.split()[0] if isinstance(folders, str) else folders[0])
    return tests / package if (workspace / tests / package).is_dir() else tests


def _write(module: str, test: str, template: str, new: Named, kind: str = "") -> None:
    """Write a module of a workspace and its test, and say where they are."""
    from palp_core.cli.workspace.templates import text, write_new
    from palp_core.errors import GraphError
    from palp_core.graph.description.launch_file import find_workspace
    from palp_core.graph.workspaces.modules import hidden_modules

    workspace = find_workspace(Path.cwd() / "file")
    if not (workspace / "nodes").is_dir():
        raise GraphError(f"no workspace here: {workspace} has no nodes/; palp init DIR writes one")
    own_rig = (workspace / "nodes" / "policy.py").is_file()
    values = {
        "NAME": new.module, "CLASS": new.class_name, "RIG": "" if own_rig else "palp_core.workspace.",
        "KIND": kind,
    }  # fmt: skip
    templates = {
        Path(module): f"{template}.py",
        _tests_of(workspace, Path(module).parts[0]) / test: f"{template.removesuffix(f'_{kind}')}_test.py",
    }
    write_new(workspace, {path: text(name, values) for path, name in templates.items()})
    for path in templates:
        print_text(str(workspace / path))
    for hiding, file, hidden, name in hidden_modules(workspace):
        if file.relative_to(workspace) in templates:
            note(f"{hiding} takes the place of that of '{name}', {hidden}")
