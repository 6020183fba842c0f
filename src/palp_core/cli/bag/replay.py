"""``palp bag replay``."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import print_json, print_text


def replay(
    bag: Annotated[Path, argument("A bag's folder or one of its files.")],
    *,
    nodes: Annotated[str, option("Running names, as in estimator,policy.", show_default=False)],
    launch: Annotated[
        Path | None, option("Launch file in the nodes' workspace; default: from here up.")
    ] = None,
    compare: Annotated[
        bool, option("With the recorded outputs; status 1 if they differ.", "--compare/--no-compare")
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Drive nodes from a bag in lockstep; compare outputs.

    Status 1: an output differs from the recorded one.
    """
    from palp_core.errors import BagError
    from palp_core.graph.description.launch_file import find_workspace
    from palp_core.graph.replay.replay import replay as drive

    workspace = find_workspace(launch or Path("launch.yaml"))
    try:
        done = drive(bag, nodes.split(","), workspace)
    except ModuleNotFoundError as error:
        raise BagError(
            f"{error}: the nodes' classes are not in {workspace}; say where they are: --launch FILE"
        ) from error
    if as_json:
        print_json(done)
    for node in [] if as_json else done:
        pace = node.clock_s / node.wall_s if node.wall_s else 0.0
        if node.divergence is None:
            beyond = f"; {node.uncovered} outputs are beyond what its order covers" if node.uncovered else ""
            print_text(
                f"{node.node}: {node.compared} outputs equal to the recorded ones, byte for byte, from "
                f"{node.consumed} inputs and ticks; {node.clock_s:.1f} s in {node.wall_s:.2f} s "
                f"({pace:.0f} times real time){beyond}"
            )
        else:
            first = node.divergence
            print_text(
                f"{node.node}: differs first on {first.topic} {first.sequence} at {first.now_s:.6f} s, after "
                f"{first.after}: {first.what} ({node.compared} outputs were equal before; it had consumed "
                f"{', '.join(first.inputs)})"
            )
    if compare and any(node.divergence is not None for node in done):
        raise typer.Exit(1)
