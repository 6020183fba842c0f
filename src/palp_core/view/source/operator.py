"""Permissions of the pages: every change that a page makes is checked here."""

from __future__ import annotations

from typing import Any

from palp_core.errors import GraphError
from palp_core.graph.discovery.message_yaml import message_from_yaml
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.node.loading import class_from_here
from palp_core.view.source.live import LiveSource

READ_ONLY = "this page is read-only; start palp view without --read-only"
NOT_OPERATED = (
    "this graph drives devices, real or emulated ones, so only stop can be pressed;"
    " start palp view with --operate"
)
ENDED = "the graph has ended"


class Refused(GraphError):
    """This must not be pressed here."""


class GraphOperator:
    """What may be done to a running graph from a page. All of it waits for answers: call it on a thread.

    With ``read_only`` nothing may be pressed, with ``operate`` everything, on a real rig too.
    """

    def __init__(self, source: LiveSource, *, read_only: bool = False, operate: bool = False) -> None:
        self._source = source
        self._read_only, self._operate = read_only, operate

    def refusal(self, *, stops: bool = False) -> str:
        """Return why nothing may be pressed just now; "" if it may. What only ``stops`` a rig always may."""
        if self._read_only:
            return READ_ONLY
        overview = self._source.overview()
        if not self._source.graph.alive:
            return ENDED
        real = overview.moves_something_real or (overview.clock == "wall" and not self._source.known)
        return NOT_OPERATED if real and not (self._operate or stops) else ""

    def allow(self, *, stops: bool = False) -> RunningGraph:
        """Return the graph, if something may be done to it; see :meth:`refusal`."""
        if why := self.refusal(stops=stops):
            raise Refused(why)
        return self._source.graph

    def set_parameters(self, node: str, texts: dict[str, str]) -> dict[str, Any]:
        """Set parameters, typed as in YAML, all of them or none; return all values as they are then."""
        graph = self.allow()
        wanted = graph.typed_parameters(node, texts)
        found: dict[str, Any] = graph.ask(node, "set_parameters", parameters=wanted)["parameters"]
        return found

    def transition(self, node: str, transition: str) -> str:
        """Ask a node for a transition of its lifecycle; return the state that it has reached."""
        reply = self.allow().ask(node, "transition", timeout_s=10.0, transition=transition)
        return str(reply["lifecycle"])

    def publish(self, node: str, port: str, text: str) -> int:
        """Publish a message, typed as YAML, into an external port; return its sequence on the topic."""
        graph = self.allow()
        _, _, described = graph.external_port(f"/{node}/{port}")
        message = message_from_yaml(text or "{}", described["json_schema"], "message")
        return int(graph.ask(node, "publish", port=port, message=message)["sequence"])

    def call(
        self, node: str, service: str, request: dict[str, Any], *, stops: bool = False
    ) -> dict[str, Any]:
        """Call a service of a node with plain values; return its reply."""
        graph = self.allow(stops=stops)
        reply: dict[str, Any] = graph.ask(node, "call", service=service, request=request)["reply"]
        return reply

    def swap(self, node: str, run: str, **options: Any) -> dict[str, Any]:
        """Replace a node's class, or reload the same one from its file: :meth:`RunningGraph.swap`.

        A file is looked for from the folder in which the viewer was started, then from the workspace.
        """
        graph = self.allow()
        return graph.swap(node, class_from_here(run, graph.record.workspace), **options)

    def end(self) -> None:
        """Ask the graph to end as Ctrl-C at its launch does, and do not wait for it."""
        with self.allow().ask_to_end("its page in the browser"):
            pass
