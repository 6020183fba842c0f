"""``palp swap``: let another class take a running node's place."""

import re
import sys
from typing import Annotated, Any

from palp_core.cli.options import INTERRUPTED, GraphOption, JsonOption, NodeArgument, argument, option
from palp_core.cli.output import note, print_json, print_text
from palp_core.cli.running import find_graph
from palp_core.counted import counted
from palp_core.errors import GraphError

FIRST_STEP = 10


def swap(
    node: NodeArgument,
    target: Annotated[
        str | None, argument("New class, or FILE.py:CLASS; default: the one that runs.", "[MODULE:CLASS]")
    ] = None,
    params: Annotated[list[str] | None, argument("Its parameters.", "[NAME:=VALUE...]")] = None,
    *,
    reload: Annotated[bool, option("The same class, from its file as it is now.", "--reload")] = False,
    shadow: Annotated[
        float, option("Run both nodes for S seconds first and compare outputs.", metavar="S", min=0.0)
    ] = 0.0,
    dry_run: Annotated[
        bool, option("Try every step, or the shadow, and change nothing.", "--dry-run")
    ] = False,
    probation: Annotated[
        str | None, option("Keep the old node for N handlers or S seconds; 0: none.", metavar="N|Ss")
    ] = None,
    timeout: Annotated[
        float,
        option("Seconds without shadow; as many for a probation.", metavar="S", min=0.1, max=3600.0),
    ] = 10.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """The old node works until the new one is ready, then hands over everything at one instant. If anything
    fails before, the old one goes on: the exit status is that of the step (10 check, 11 start, 12 configure,
    13 connect, 14 state, 15 shadow, 16 hand over, 17 take over, 18 probation).
    """
    from palp_core.cli.values import assignments, value_of
    from palp_core.graph.description.checked import unpublished_words
    from palp_core.graph.discovery.choice import addressed
    from palp_core.graph.node.loading import class_from_here
    from palp_core.graph.swap.swap import MOST_RUNS, STEPS, Probation

    given = list(params or [])
    if target is not None and ":=" in target:
        given, target = [target, *given], None
    if reload if target is not None else not (reload or given):
        raise GraphError(
            "name the new class, as in nodes.policy_uniform:Uniform, or --reload the one that runs, "
            "or give parameters for it, as in rate_hz:=50"
        )
    if target is not None and not all(target.rpartition(":")[::2]):
        raise GraphError(f"'{target}' is not a class; write MODULE:CLASS or FILE.py:CLASS")
    options: dict[str, Any] = {"params": {k: value_of(v) for k, v in assignments("parameter", given).items()}}
    if probation is not None:
        options["probation"] = _probation(probation)
    running = find_graph(graph, changes=True)
    run = class_from_here(target, running.record.workspace) if target is not None else ""
    try:
        answer = running.swap(node, run, timeout_s=timeout, shadow_s=shadow, dry_run=dry_run, **options)
    except KeyboardInterrupt:
        shown_by = addressed(f"palp node info {node}", running.record.id)
        note(f"the launcher continues the swap; result: {shown_by}")
        sys.exit(INTERRUPTED)
    if as_json:
        print_json(answer)
    failed = answer.get("failed")
    if failed:
        note(f"/{failed['node']} not swapped, the old node continues: {failed['step']}: {failed['text']}")
        sys.exit(FIRST_STEP + STEPS.index(failed["step"]))
    few, what = answer["report"]["proven"], answer["report"]["proven_by"]
    wanted = options.get("probation", {}).get("run_count", Probation().run_count)
    if few == 0 or 0 < few < wanted < MOST_RUNS:
        ran = f"no {what}" if few == 0 else f"only {counted(few, what)}"
        note(
            f"probation ended after {ran} of the new node, without a failure; the old node is gone "
            "(for longer: --timeout, or --probation Ss)"
        )
    if not as_json:
        _print(answer["report"])
    if text := unpublished_words(answer["report"]["unpublished"]):
        note(text)


def _probation(text: str) -> dict[str, Any]:
    """Return how many handlers, or how long."""
    from palp_core.graph.swap.swap import LONGEST_S, MOST_RUNS

    given = re.fullmatch(r"([0-9]{1,7})|([0-9]{1,5}(?:\.[0-9]{1,9})?)s", text)
    if given and given[1] and int(given[1]) <= MOST_RUNS:
        return {"run_count": int(given[1])}
    if given and given[2] and (longest_s := float(given[2])) <= LONGEST_S:
        return {"run_count": MOST_RUNS if longest_s else 0, "longest_s": longest_s}
    raise GraphError(f"--probation {text}: write a number of handlers, as in 5, or of seconds, as in 2.5s")


def _print(report: dict[str, Any]) -> None:

    shadow = report["shadow"]
    if shadow:
        print_text(shadow["text"])
    if not report["switched"]:
        who = f"{report['after']} could take over from {report['before']}"
        print_text(f"/{report['node']}: {who}; nothing was changed")
        return
    count, what = report["proven"], report["proven_by"]
    proven = f"; probation: {counted(count, what)} ok" if count > 0 else ""
    print_text(
        f"/{report['node']} swapped: {report['before']} -> {report['after']} at {report['at_s']:.3f} s "
        f"(gap {report['gap_s'] * 1e3:.2f} ms, {counted(report['held'], 'message')} waited, "
        f"{report['duration_s'] * 1e3:.0f} ms in all{proven})"
    )
