"""``palp init`` and ``palp new``: a workspace of your own, and a file with its test in it."""

from __future__ import annotations

import keyword
import re
import shlex
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import typer

from palp_core.cli.options import argument, option
from palp_core.cli.output import note, print_text
from palp_core.counted import counted
from palp_core.errors import GraphError

RECORDED = "tests/golden/session.mcap"
"""What ``launch/replay.yaml`` of the rig plays, if it is given nothing else."""
_SHOWN = 3
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_IMPORTS = re.compile(r"(?:^from (?:nodes|msgs|drivers|palp_core)\b.*\n)+", re.MULTILINE)
_SUFFIX = ".txt"  # so that no tool takes them for sources of palp's own

app = typer.Typer()

NameArgument = Annotated[str, argument("As in grip_force, or GripForce.", "NAME")]


def init(
    folder: Annotated[Path, argument("A new folder, or an empty one.", "DIR")],
    *,
    rig: Annotated[bool, option("With the whole rig in it, to be changed.", "--rig")] = False,
    minimal: Annotated[bool, option("Two files: a launch file and a node.", "--minimal")] = False,
) -> None:
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
    if folder.exists() and not folder.is_dir():
        raise GraphError(f"{folder} is a file; name a new folder")
    there = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    if there:
        more = ", ..." if len(there) > _SHOWN else ""
        raise GraphError(
            f"{folder} is not empty (it has {', '.join(there[:_SHOWN])}{more}); name a new folder"
        )


@app.command()
def node(name: NameArgument) -> None:
    """Write nodes/NAME.py and its test."""
    new = named(name)
    _write(f"nodes/{new.module}.py", f"test_{new.module}.py", "node", new)
    print_text(
        f"into a launch file, under nodes:\n  {new.module}:\n    run: nodes.{new.module}:{new.class_name}\n"
        f"    inputs: {{received: NODE/progress}}"
    )


@app.command()
def message(name: NameArgument) -> None:
    """Write msgs/NAME.py and its test."""
    new = named(name)
    _write(f"msgs/{new.module}.py", f"test_{new.module}_message.py", "message", new)
    print_text(f"in a node: from msgs.{new.module} import {new.class_name}")


@app.command()
def policy(name: NameArgument) -> None:
    """Write nodes/policy_NAME.py, a policy of the rig."""
    new = named(name.removeprefix("policy_"))
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
    new = named(name)
    _write(f"drivers/{new.module}.py", f"test_{new.module}_driver.py", f"driver_{kind}", new, kind)
    run = f"drivers.{new.module}:{new.class_name}"
    print_text(f"in a launch file, of the node of that device: device: {run}")
    if kind == "stage":
        print_text(
            f"in the rig, with what stops it: palp launch rig:rig.yaml stage_device:={run} "
            "safety.stop_link:=none 'safety.options:={}' 'stage.options:={}'"
        )


def _tests_of(workspace: Path, package: str) -> Path:
    """Return where a workspace keeps the tests of its nodes, messages or drivers, from the workspace.

    It is a folder of the package's name in the first folder of the test paths of pytest, or that folder.
    """
    settings = {}
    if (workspace / "pyproject.toml").is_file():
        settings = tomllib.loads((workspace / "pyproject.toml").read_text(encoding="utf-8"))
    pytest = settings.get("tool", {}).get("pytest", {}).get("ini_options", {})
    folders = pytest.get("testpaths", "tests")
    tests = Path(folders.split()[0] if isinstance(folders, str) else folders[0])
    return tests / package if (workspace / tests / package).is_dir() else tests


def _write(module: str, test: str, template: str, new: Named, kind: str = "") -> None:
    """Write a module of a workspace and its test, and print where they are."""
    from palp_core.graph.description.launch_file import find_workspace
    from palp_core.graph.workspaces.modules import hidden_modules

    workspace = find_workspace(Path.cwd() / "file")
    if not (workspace / "nodes").is_dir():
        raise GraphError(f"no workspace here: {workspace} has no nodes/; palp init DIR writes one")
    own_rig = (workspace / "nodes" / "policy.py").is_file()
    values = {
        "NAME": new.module, "CLASS": new.class_name, "RIG": "" if own_rig else "palp_core.workspace.",
        "KIND": kind, "CONTRACT": f"{kind.capitalize()}Contract",
    }  # fmt: skip
    templates = {
        Path(module): f"{template}.py",
        _tests_of(workspace, Path(module).parts[0]) / test: f"{template.removesuffix(f'_{kind}')}_test.py",
    }
    write_new(workspace, {path: text(name, values) for path, name in templates.items()})
    if workspace != Path.cwd():
        note(f"the workspace of this folder is {workspace}")
    for path in templates:
        print_text(str(workspace / path))
    for hiding, file, hidden, name in hidden_modules(workspace):
        if file.relative_to(workspace) in templates:
            note(f"{hiding} takes the place of that of '{name}', {hidden}")


class Named(NamedTuple):
    """A name as a module, ``grip_force``, and as a class, ``GripForce``."""

    module: str
    class_name: str


def named(word: str) -> Named:
    """Return a name in both its forms.

    >>> named("grip_force"), named("EMGReader")
    (Named(module='grip_force', class_name='GripForce'), Named(module='emg_reader', class_name='EmgReader'))
    """
    if not _NAME.fullmatch(word):
        raise GraphError(
            f"'{word}' is not a name; begin with a letter, then letters, digits and _, as in grip_force"
        )
    module = _HUMP.sub("_", word).lower().strip("_")
    class_name = "".join(part[:1].upper() + part[1:] for part in module.split("_"))
    if keyword.iskeyword(module) or keyword.iskeyword(class_name):
        raise GraphError(f"'{word}' is a word of Python; take another name")
    return Named(module, class_name)


def texts(folder: str, values: Mapping[str, str]) -> dict[Path, str]:
    """Return the files of a folder of templates, by the path that each gets, with ``__KEY__`` filled in."""
    root = _root() / folder
    found = sorted(root.rglob(f"*{_SUFFIX}"))
    return {path.relative_to(root).with_suffix(""): _filled(path, values) for path in found}


def text(name: str, values: Mapping[str, str]) -> str:
    """Return a file of what ``palp new`` writes, with ``__KEY__`` filled in."""
    return _filled(_root() / "new" / f"{name}{_SUFFIX}", values)


def _root() -> Path:
    return Path(str(files("palp_core.cli.workspace"))) / "templates"


def _filled(path: Path, values: Mapping[str, str]) -> str:
    filled = path.read_text(encoding="utf-8")
    for key, value in values.items():
        filled = filled.replace(f"__{key}__", value)
    return _IMPORTS.sub(lambda block: "".join(sorted(block[0].splitlines(keepends=True))), filled)


def write_new(folder: Path, contents: Mapping[Path, str | bytes]) -> None:
    """Write files into a folder, all or none."""
    there = [str(path) for path in contents if (folder / path).exists()]
    if there:
        raise GraphError(
            f"{', '.join(there)} in {folder}: already there, and left as it is; take another name"
        )
    for path, content in contents.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with (folder / path).open("xb") as file:
            file.write(content if isinstance(content, bytes) else content.encode())
