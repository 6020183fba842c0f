"""Who may ask for a swap, and what a graph is afterwards: a tool, Python, or an experiment by its plan."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import GraphError, NodeError, in_words
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClassRequest
from palp_core.graph.description.wire_check import disagreements
from palp_core.graph.lockstep.conductor import Conductor
from palp_core.graph.messages.builtin import Swap as SwapMessage
from palp_core.graph.node.loading import source_of
from palp_core.graph.node.params import changed_read_only
from palp_core.graph.node.spec import RECORDER, NodeSpec
from palp_core.graph.problems import hint
from palp_core.graph.process.control_messages import Done
from palp_core.graph.swap.compatibility import incompatibilities, replaced
from palp_core.graph.swap.engine import Swap
from palp_core.graph.swap.step_engine import SwapHost
from palp_core.graph.swap.swap import (
    NO_PROBATION,
    STEPS,
    AskToSwap,
    CheckedSwap,
    Probation,
    SwapFailed,
    SwapReport,
    SwapRequest,
)


def _run_of(request: SwapRequest, old: NodeSpec, workspace: str) -> str:
    """Return what is to run; the class that runs keeps its name, be it given by its module or file."""
    known = source_of(old.run, workspace)
    same = not request.run or (known is not None and source_of(request.run, workspace) == known)
    return old.run if same else request.run


class Swapper:
    """The swaps of one graph."""

    def __init__(
        self,
        checked: CheckedGraph,
        host: SwapHost,
        folder: Path,
        now_ns: Callable[[], int],
        changed: Callable[[CheckedGraph, int, Done | None], None],
        report: Callable[..., None],
    ) -> None:
        self.conductor: Conductor | None = None  # in simulated time, once the run begins
        self._checked, self._host, self._folder, self._now_ns = checked, host, folder, now_ns
        self._current: Swap | None = None
        self._changed, self._report = changed, report
        self._busy = ""
        self._planned: list[tuple[int, SwapRequest]] = []

    def plan(self, at_ns: int, request: SwapRequest) -> None:
        """Swap when it is that time on the graph's clock."""
        if request.probation is None:  # one that fails ends the run: standby would serve nothing
            request = msgspec.structs.replace(request, probation=NO_PROBATION)
        self._planned.append((at_ns, request))

    def plan_asked(self, now_ns: int, name: str, asked: SwapMessage) -> None:
        """Swap as a node asks by a message on a topic."""
        try:
            params = msgspec.json.decode(asked.params, type=dict[str, Any])
        except msgspec.MsgspecError as error:
            text = f"'params' of its Swap message is not a JSON map: {in_words(error)}: {asked.params!r}"
            raise NodeError(name.split("/")[1], text) from error
        self.plan(now_ns, SwapRequest(node=asked.node, run=asked.run, params=params))

    def run_due(self) -> None:
        """Do what is planned and due."""
        if self._busy or not self._planned:  # simulated time goes by in a swap, too
            return
        now_ns = self._now_ns()
        due = [request for at_ns, request in self._planned if at_ns <= now_ns]
        self._planned = [entry for entry in self._planned if entry[0] > now_ns]
        for request in due:
            try:
                self.swap(request)
            except GraphError as error:
                raise SwapFailed(request.node, "check", str(error)) from error

    @property
    def _busy_text(self) -> str:
        return f"a swap of /{self._busy.removeprefix('/')} is under way; ask again when it is done"

    def progress(self) -> dict[str, Any]:
        """Return which node is being swapped, if any, and its step."""
        step = self._current.step if self._current is not None else STEPS[0] if self._busy else ""
        return {"node": self._busy.removeprefix("/"), "step": step, "steps": STEPS}

    def answer(self, asked: AskToSwap) -> dict[str, Any]:
        if self._busy:
            return {"failed": {"step": "start", "text": self._busy_text, "node": asked.request.node}}
        try:
            found: dict[str, Any] = msgspec.to_builtins(self.swap(asked.request))
        except SwapFailed as error:
            return {"failed": {"step": error.step, "text": error.text, "node": error.node}}
        return {"report": found}

    def swap(self, request: SwapRequest) -> SwapReport:
        """Let another class take a node's place."""
        if self._busy:
            raise GraphError(self._busy_text)
        self._busy = request.node
        try:
            report, done, now = self._swap(request)
        except SwapFailed as error:
            self._report("swap_failed", error.node, f"{error.step}: {error.text}", step=error.step)
            raise
        finally:
            self._busy, self._current = "", None
        if report.switched:
            text = f"{report.before} -> {report.after}, gap {report.gap_s * 1e3:.2f} ms, {report.held} held"
            self._checked = now.checked
            self._changed(now.checked, now.index, done)
            given = {"given": request.params} if request.params else {}
            self._report("swapped", report.node, text, **msgspec.to_builtins(report), **given)
        return report

    def _swap(self, request: SwapRequest) -> tuple[SwapReport, Done | None, CheckedSwap]:
        checked = self._checked
        specs = {spec.name: spec for spec in checked.spawned}
        name = request.node.removeprefix("/")
        if name not in specs:
            elsewhere = any(spec.name == name for spec in checked.expected)
            why = "lives on another host; swap it there" if elsewhere else f"is not there{hint(name, specs)}"
            raise GraphError(f"node '{name}' of graph '{checked.graph}' {why}")
        old = specs[name]
        if old.run == RECORDER:
            raise GraphError(f"node '{name}' is a recorder; record in addition: palp bag record -a")
        run = _run_of(request, old, checked.workspace)
        before = old.params if run == old.run else {}
        wanted = NodeClassRequest(run, {**before, **request.params}, name=name)
        new_class = self._host.inspect_class(wanted, Path(checked.workspace), request.timeout_s)
        new_class = msgspec.structs.replace(new_class, run=run)
        wrong = incompatibilities(checked, old, new_class)
        if run == old.run:
            fixed = changed_read_only(new_class.params, old.params, request.params)
            wrong += [f"parameter '{one}' is read-only; state it in the launch file" for one in fixed]
        if wrong:
            raise SwapFailed(name, "check", f"{run}: " + "; ".join(wrong))
        now = replaced(checked, old, new_class, request.params)
        if apart := [found.text for found in disagreements(now)]:
            raise SwapFailed(name, "check", f"{run}: " + "; ".join(apart))
        new = next(spec for spec in now.spawned if spec.name == name)
        usual = Probation() if new_class.on_probation else NO_PROBATION
        swap = CheckedSwap(
            request=msgspec.structs.replace(request, node=name),
            probation=usual if request.probation is None else request.probation,
            try_out=new_class.on_probation,
            index=list(specs).index(name),
            old=old,
            new=new,
            checked=now,
        )
        self._current = Swap(self._host, self._folder, swap, self._now_ns(), self.conductor)
        return *self._current.run(), swap
