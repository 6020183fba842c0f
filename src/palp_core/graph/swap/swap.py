"""Hot swap: let another class take a running node's place, at one handler boundary, or leave all as it was.

What is asked for, what came of it, and who may ask: a tool, Python, or an experiment by its plan.
The steps themselves are in :mod:`.process_swap` and :mod:`.composed_swap`.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Protocol

import msgspec

from palp_core.errors import GraphError, NodeError
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.description.wire_check import disagreements
from palp_core.graph.messages.builtin import Swap
from palp_core.graph.messages.frame import Kind, parse, topic_of
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.schema_reader import array_fields
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.loading import source_of
from palp_core.graph.node.params import changed_read_only
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.problems import hint
from palp_core.graph.process.control_messages import Done
from palp_core.graph.process.shadow import ShadowComparison
from palp_core.graph.process.swap_messages import HANDLER
from palp_core.graph.swap.compatibility import incompatibilities, replaced
from palp_core.graph.transport.request_server import NodeRequest

TIMEOUT_S = 10.0
LONGEST_S = 86_400.0
MOST_RUNS = 1_000_000
STEPS = ("check", "start", "configure", "connect", "state", "shadow", "hand over", "take over", "probation")
"""In their order; after the last the new node works by itself."""


class Probation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How long the old node is on standby, and goes on if the new one fails: what is over first.

    Attributes:
        run_count: Handlers that have to run well, or what else proves it by its class; 0:
            there is no probation.
        longest_s: The longest it lasts, on the graph's clock; None: however long the handlers take there, but
            no longer than the swap's ``timeout_s`` of the machine's time.
    """

    run_count: Annotated[int, msgspec.Meta(ge=0, le=MOST_RUNS)] = 3
    longest_s: Annotated[float, msgspec.Meta(ge=0.0, le=LONGEST_S)] | None = None


NO_PROBATION = Probation(0, 0.0)


class SwapRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is asked for.

    Attributes:
        node: Whose place is taken.
        run: ``module:Class`` or ``path.py:Class``; "": the class that runs, from its source as it is now.
        params: Parameters of the new node; of the same class, those that are to change.
        timeout_s: How long all of it may take, shadow and probation not counted.
        shadow_s: So long, on the graph's clock, both work and only the old one publishes.
        dry_run: Change nothing in the end.
        probation: How long the old node is on standby; None: as the new class states.
    """

    node: str
    run: str = ""
    params: dict[str, Any] = {}
    timeout_s: Annotated[float, msgspec.Meta(gt=0.0, le=LONGEST_S)] = TIMEOUT_S
    shadow_s: Annotated[float, msgspec.Meta(ge=0.0, le=LONGEST_S)] = 0.0
    dry_run: bool = False
    probation: Probation | None = None


class AskToSwap(NodeRequest, frozen=True, kw_only=True):
    """A tool asks for a swap."""

    request: SwapRequest


class SwapReport(msgspec.Struct, frozen=True, kw_only=True):
    """What came of it.

    Attributes:
        at_s: When, on the graph's clock.
        gap_s: From when the old node took up nothing more to when the new one did; in simulated time 0.
        held: Messages that waited meanwhile.
        duration_s: From the request to the end of the old node.
        shadow: How the outputs of both compare, if they worked side by side.
        switched: False after a dry run.
        proven: Handlers of the new node that ran well while the old one was on standby; -1: it was not.
        unpublished: Topics that the new class does not publish, with the optional inputs wired to them.
        proven_by: What was counted, if something else proves it by its class: choice.
    """

    node: str
    before: str
    after: str
    at_s: float
    gap_s: float
    held: int
    duration_s: float
    shadow: dict[str, Any] = {}
    switched: bool = True
    proven: int = -1
    unpublished: dict[str, list[str]] = {}
    proven_by: str = HANDLER


class SwapFailed(NodeError):
    """The old node works, and nothing has changed.

    Attributes:
        step: Which step failed.
    """

    def __init__(self, node: str, step: str, text: str) -> None:
        self.step, self.text = step, text
        super().__init__(node, f"its swap failed at step '{step}': {text}; the old node goes on")


class CheckedSwap(msgspec.Struct, frozen=True, kw_only=True):
    """One node in place of another: the place, who had it, who gets it.

    Attributes:
        probation: How long the former is on standby.
        try_out: Before that the new one is tried on the last messages.
    """

    request: SwapRequest
    probation: Probation
    try_out: bool
    index: int
    old: NodeSpec
    new: NodeSpec
    checked: CheckedGraph

    @property
    def standby_s(self) -> float:
        """How long the former is on standby at the most, of the machine's time where none is stated."""
        longest_s = self.probation.longest_s
        return self.request.timeout_s if longest_s is None else longest_s

    def report(self, *, at_ns: int, **found: Any) -> SwapReport:
        """Return what came of it, which was at that time on the graph's clock."""
        return SwapReport(
            node=self.request.node,
            before=self.old.run,
            after=self.new.run,
            at_s=at_ns / 1e9,
            switched=not self.request.dry_run,
            unpublished={
                name: ends for name, ends in self.checked.unpublished.items() if name in self.new.vacant
            },
            **found,
        )

    def comparison(self, published: Mapping[str, int]) -> ShadowComparison:
        """Return what compares the two nodes' messages after those that were published before."""
        arrays = {name: array_fields(info.json_schema) for name, info in self.checked.topics.items()}
        return ShadowComparison(published, arrays)


def why_not_swappable(found: HandOver, swap: CheckedSwap) -> str:
    """Return why a node as it is now cannot be replaced, or ""."""
    if found.finished:
        return "it has finished its work"
    if found.active and (swap.old.moves or swap.new.moves):
        return (
            "it moves something and is active; bring it to its safe state first: "
            f"palp lifecycle set /{swap.request.node} deactivate"
        )
    return ""


def _run_of(request: SwapRequest, old: NodeSpec, workspace: str) -> str:
    """Return what is to run; the class that runs keeps its name, be it given by its module or file."""
    known = source_of(old.run, workspace)
    same = not request.run or (known is not None and source_of(request.run, workspace) == known)
    return old.run if same else request.run


class SwapBackend(Protocol):
    """The nodes, as a swap needs them."""

    @property
    def step(self) -> str:
        """The step that the swap which is under way has come to; "" if there is none."""

    def inspect_class(self, request: NodeClassRequest, timeout_s: float) -> NodeClass:
        """Import a class where that does no harm, and return what it declares."""

    def swap(self, swap: CheckedSwap, now_ns: int) -> tuple[SwapReport, Done | None]:
        """Do it; return what came of it and, in lockstep, what the two nodes have published.

        Raises:
            SwapFailed: Nothing has changed.
        """


class Swapper:
    """The swaps of one graph.

    Args:
        checked: The graph as it is.
        backend: Its nodes.
        now_ns: The graph's clock.
        changed: Takes the graph as it is now, the node's index and what the two nodes have published.
        report: Publishes what has happened: kind, node, text, data.
    """

    def __init__(
        self,
        checked: CheckedGraph,
        backend: SwapBackend,
        now_ns: Callable[[], int],
        changed: Callable[[CheckedGraph, int, Done | None], None],
        report: Callable[..., None],
    ) -> None:
        self._checked, self._backend, self._now_ns = checked, backend, now_ns
        self._changed, self._report = changed, report
        self._busy = ""
        self._planned: list[tuple[int, SwapRequest]] = []
        wanted = schema_of(Swap).hash_text
        self._asks = {name.encode() for name, info in checked.topics.items() if info.type_hash == wanted}

    def plan(self, at_ns: int, request: SwapRequest) -> None:
        """Swap when it is that time on the graph's clock."""
        if request.probation is None:  # one that fails ends the run: standby would serve nothing
            request = msgspec.structs.replace(request, probation=NO_PROBATION)
        self._planned.append((at_ns, request))

    def observe(self, now_ns: int, frame: bytes) -> None:
        """Take a message that a node publishes, which may ask for a swap."""
        if self._asks and topic_of(frame) in self._asks and (parsed := parse(frame)).kind == Kind.DATA:
            asked = decode(Swap, parsed.payload)
            try:
                params = msgspec.json.decode(asked.params, type=dict[str, Any])
            except msgspec.MsgspecError as error:
                text = f"'params' of its Swap message is not a JSON map: {error}: {asked.params!r}"
                raise NodeError(parsed.topic.split("/")[1], text) from error
            self.plan(now_ns, SwapRequest(node=asked.node, run=asked.run, params=params))

    def run_due(self) -> None:
        """Do what is planned and due.

        Raises:
            SwapFailed: The run would not follow its plan.
        """
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
        step = self._backend.step or (STEPS[0] if self._busy else "")
        return {"node": self._busy.removeprefix("/"), "step": step, "steps": STEPS}

    def answer(self, asked: AskToSwap) -> dict[str, Any]:
        """Swap for a tool that asks.

        Raises:
            GraphError: No such node here.
        """
        if self._busy:
            return {"failed": {"step": "start", "text": self._busy_text, "node": asked.request.node}}
        try:
            found: dict[str, Any] = msgspec.to_builtins(self.swap(asked.request))
        except SwapFailed as error:
            return {"failed": {"step": error.step, "text": error.text, "node": error.node}}
        return {"report": found}

    def swap(self, request: SwapRequest) -> SwapReport:
        """Let another class take a node's place.

        Raises:
            GraphError: No such node here.
            SwapFailed: A step failed; the old node goes on.
        """
        if self._busy:
            raise GraphError(self._busy_text)
        self._busy = request.node
        try:
            report, done, now = self._swap(request)
        except SwapFailed as error:
            self._report("swap_failed", error.node, f"{error.step}: {error.text}", step=error.step)
            raise
        finally:
            self._busy = ""
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
        run = _run_of(request, old, checked.workspace)
        before = old.params if run == old.run else {}
        wanted = NodeClassRequest(run, {**before, **request.params}, name=name)
        new_class = self._backend.inspect_class(wanted, request.timeout_s)
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
        return *self._backend.swap(swap, self._now_ns()), swap
