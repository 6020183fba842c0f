"""How a run went, and what its launch file's report function makes of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.launch.run_journal import Incident, MethodSpan, RunChange
from palp_core.graph.node.loading import load_module


class RunSummary(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a run, which the launch file's report function receives.

    Attributes:
        run: Id of the run on this host.
        args: The launch file's arguments as resolved.
        given: Those that were given, ``name:=value``.
        resumed_count: How often the run was interrupted and went on from a checkpoint.
        params: Parameters of every node, by node; what was set while it ran is among the changes.
        publishes: Message type of each topic that a node publishes, by node.
        listens: Topics that each node reads, by node.
        clock_s: Time on the graph's clock.
        wall_s: Wall time from activation to the end.
        activation_count: How often a node was given work, in lockstep; None where it was not counted.
        exit_code: 0 if the run came to its end, with its report; negative where it did not say how it ended.
        ended: Why it did not come to its end; "" where it did.
        incidents: What nodes reported as wrong, in time's order.
        attached: Texts that the report function wants kept with all that is recorded of the run, by name.
        cpu_s: CPU time of each node's process; of those that were asked, on the wall clock.
        methods: Which methods nodes reported, and from when on, in time's order.
        changes: Classes that took a node's place, and parameters that were set, in time's order.
        report: Text of the launch file's report function; "" if there is none.
    """

    graph: str
    file: str
    run: str = ""
    clock: str
    seed: int
    composed: bool = False
    args: dict[str, Any]
    given: list[str] = []
    resumed_count: int = 0
    params: dict[str, dict[str, Any]]
    publishes: dict[str, dict[str, str]]
    listens: dict[str, list[str]]
    attached: dict[str, str] = {}
    exit_code: int = -1
    ended: str = "no end was reported"
    clock_s: float = 0.0
    wall_s: float = 0.0
    activation_count: int | None = 0
    incidents: list[Incident] = []
    methods: list[MethodSpan] = []
    cpu_s: dict[str, float] = {}
    changes: list[RunChange] = []
    report: str = ""


def summary_of(checked: CheckedGraph, path: Path, **outcome: Any) -> RunSummary:
    return RunSummary(
        graph=checked.graph,
        file=str(path),
        clock=checked.clock,
        seed=checked.seed,
        args=checked.args,
        params={spec.name: spec.params for spec in checked.nodes},
        publishes=checked.publishes,
        listens=checked.listens,
        attached=checked.attached,
        composed=checked.composed,
        **outcome,
    )


def report_function(target: str, workspace: str) -> Callable[[RunSummary], str]:
    module_name, _, name = target.partition(":")
    function: Callable[[RunSummary], str] = getattr(load_module(module_name, workspace), name)
    return function
