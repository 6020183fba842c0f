"""What a bag has of the run it holds: graph, parameters, nodes, versions, git state.

Every launcher can be asked for it, and few are: what it takes is imported then.
"""

import json
from pathlib import Path
from typing import Any

import msgspec

from palp_core.graph.description.checked import CheckedGraph, resolved_yaml

PACKAGES = ("numpy", "scipy", "pywavelets", "msgspec", "msgpack", "pyzmq")
LAUNCH_ATTACHMENT = "palp/launch.json"
_YAML, _NODES, _WORKSPACE, _LAUNCH = "graph_yaml", "nodes", "workspace", "launch"


def launch_provenance(graph: CheckedGraph) -> dict[str, Any]:
    """Return what only the launcher knows, as plain data for a recorder of its graph."""
    return {
        _YAML: resolved_yaml(graph),
        _NODES: msgspec.to_builtins(graph.nodes),
        _WORKSPACE: graph.workspace,
        _LAUNCH: {
            "graph": graph.graph,
            "file": graph.file,
            "clock": graph.clock,
            "seed": graph.seed,
            "args": graph.args,
            "params": {spec.name: spec.params for spec in graph.nodes},
            "publishes": graph.publishes,
            "listens": graph.listens,
            "composed": graph.composed,
            "attached": graph.attached,
            "view": graph.view,
        },
    }


def attachments(
    provenance: dict[str, Any], params: dict[str, dict[str, Any]] | None = None
) -> dict[str, bytes]:
    from palp_core.graph.bag.rounds import NODES_ATTACHMENT

    launched = {spec["name"]: spec["params"] for spec in provenance[_NODES]}
    return {
        "palp/graph.yaml": provenance[_YAML].encode(),
        NODES_ATTACHMENT: msgspec.json.format(msgspec.json.encode(provenance[_NODES])),
        "palp/parameters.json": json.dumps(launched | (params or {}), indent=1).encode(),
        LAUNCH_ATTACHMENT: launch_attachment(provenance),
        "palp/versions.json": json.dumps(versions(), indent=1).encode(),
        "palp/git.txt": _git_state(Path(provenance[_WORKSPACE])),
    }


def launch_attachment(provenance: dict[str, Any]) -> bytes:
    """Return the attachment of what runs: changed by a swap, the latest one counts."""
    return json.dumps(provenance[_LAUNCH], indent=1).encode()


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a run depends on."""
    import platform
    from importlib import import_module
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": platform.python_version(), "palp": import_module("palp_core").__version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _git_state(workspace: Path) -> bytes:
    """Return commit and changed files of the workspace; empty where it is no checkout or there is no git."""
    import subprocess

    output = b""
    for command in (("rev-parse", "HEAD"), ("status", "--porcelain")):
        try:
            output += subprocess.run(
                ("git", "-C", str(workspace), *command), capture_output=True, check=True, timeout=10.0
            ).stdout
        except (OSError, subprocess.SubprocessError):
            return output
    return output
