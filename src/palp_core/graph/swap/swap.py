"""Hot swap: let another class take a running node's place, at one handler boundary, or leave all as it was.

What is asked for and what came of it; who may ask is in :mod:`.swapper`, the steps are in :mod:`.engine`.
"""

from collections.abc import Mapping
from typing import Annotated, Any

import msgspec

from palp_core.errors import NodeError
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.messages.schema_reader import array_fields
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.shadow import ShadowComparison
from palp_core.graph.process.swap_messages import HANDLER
from palp_core.graph.transport.request_server import NodeRequest

TIMEOUT_S = 10.0
LONGEST_S = 86_400.0
MOST_RUNS = 1_000_000
STEPS = ("check", "start", "configure", "connect", "state", "shadow", "hand over", "take over", "probation")
"""In their order; after the last the new node works by itself."""


class Probation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How long the old node can still take over again if the new one fails.

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
    """A step failed: the old node works, and nothing has changed."""

    def __init__(self, node: str, step: str, text: str) -> None:
        self.step, self.text = step, text
        super().__init__(node, f"its swap failed at step '{step}': {text}; the old node goes on")


class CheckedSwap(msgspec.Struct, frozen=True, kw_only=True):
    """One node in place of another: the place, who had it, who gets it."""

    request: SwapRequest
    probation: Probation  # how long the former is on standby
    try_out: bool  # before that the new one is tried on the last messages
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
