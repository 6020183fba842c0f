"""``palp new``: a file of one's own, with its test, in the workspace that one is in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.output import note, print_text

if TYPE_CHECKING:
    from palp_core.cli.workspace.templates import Named

_HERE = "palp_core.cli.workspace.new"

app = lazy_app(
    "Write a node, message, policy or driver, with its test, into the workspace one is in.",
    {
        "node": Verb(f"{_HERE}:node", "Write nodes/NAME.py and its test."),
        "message": Verb(f"{_HERE}:message", "Write msgs/NAME.py and its test."),
        "policy": Verb(f"{_HERE}:policy", "Write nodes/policy_NAME.py, a policy of the rig, and its test."),
        "driver": Verb(f"{_HERE}:driver", "Write drivers/NAME.py, a driver of a device, and its test."),
    },
)

NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="As in grip_force, or GripForce.", show_default=False)
]


def node(name: NameArgument) -> None:
    """Write nodes/NAME.py and its test."""
    new = _named(name)
    _write({f"nodes/{new.module}.py": "node.py", f"tests/test_{new.module}.py": "node_test.py"}, new)
    print_text(
        f"into a launch file, under nodes:\n  {new.module}:\n    run: nodes.{new.module}:{new.class_name}\n"
        f"    inputs: {{heard: NODE/progress}}"
    )


def message(name: NameArgument) -> None:
    """Write msgs/NAME.py and its test."""
    new = _named(name)
    _write(
        {f"msgs/{new.module}.py": "message.py", f"tests/test_{new.module}_message.py": "message_test.py"}, new
    )
    print_text(f"in a node: from msgs.{new.module} import {new.class_name}")


def policy(name: NameArgument) -> None:
    """Write nodes/policy_NAME.py, a policy of the rig, and its test."""
    new = _named(name.removeprefix("policy_"))
    module = f"policy_{new.module}"
    _write({f"nodes/{module}.py": "policy.py", f"tests/test_{module}.py": "policy_test.py"}, new)
    print_text(
        f"from the first palpation on: palp launch rig:sim.yaml policy:=nodes.{module}:{new.class_name} "
        "trials:=2 training:=3 --compose\n"
        f"in a run: palp swap policy nodes.{module}:{new.class_name}"
    )


def driver(
    name: NameArgument,
    *,
    kind: Annotated[Literal["torque", "emg"], typer.Option(help="What the device is.", show_default=False)],
) -> None:
    """Write drivers/NAME.py, a driver of a device, and its test."""
    new = _named(name)
    _write(
        {
            f"drivers/{new.module}.py": f"driver_{kind}.py",
            f"tests/test_{new.module}_driver.py": f"driver_{kind}_test.py",
        },
        new,
    )
    print_text(f"in a launch file, of the node of that device: device: drivers.{new.module}:{new.class_name}")


def _named(name: str) -> Named:
    from palp_core.cli.workspace.templates import named

    return named(name)


def _write(templates: dict[str, str], new: Named) -> None:
    """Write files of a workspace, by path, and say which they are.

    Raises:
        GraphError: One is no workspace, or a file is there already.
    """
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
    }  # fmt: skip
    write_new(workspace, {Path(path): text(template, values) for path, template in templates.items()})
    for path in templates:
        print_text(str(workspace / path))
    for module, file, hidden, name in hidden_modules(workspace):
        if str(file.relative_to(workspace)) in templates:
            note(f"{module} takes the place of that of '{name}', {hidden}")
