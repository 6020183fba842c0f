"""The launcher's end of the gateway: started before any node, followed while the graph runs."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode
from palp_core.graph.network import join_protocol
from palp_core.graph.network.address import plan_listening
from palp_core.graph.network.join_protocol import GraphView, JoinRequest
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.node.loading import endpoints
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage
from palp_core.graph.supervision.liveness import Liveness
from palp_core.graph.supervision.sidecar import Sidecar

if TYPE_CHECKING:
    from palp_core.graph.supervision.supervisor import Supervisor

START_TIMEOUT_S = 20.0
MOST_RESTARTS = 5
_LOG = logging.getLogger("palp.gateway")
_DECODER: msgspec.msgpack.Decoder[join_protocol.FromGateway] = msgspec.msgpack.Decoder(
    join_protocol.FromGateway
)


def view_of(checked: CheckedGraph) -> GraphView:
    """Return a graph as other hosts see it."""
    return GraphView(
        graph=checked.graph,
        clock=checked.clock,
        nodes=[spec.name for spec in checked.spawned],
        topics=checked.topics,
        expected={spec.name: spec for spec in checked.expected},
    )


class GatewayHandle:
    """A graph's gateway as its launcher sees it; it can be called before any node starts.

    It reports the events ``joined``, ``left``, ``refused``, ``failed``, ``restarted``, ``unresponsive`` and
    ``responsive``, and calls ``changed`` when a node has joined or left.
    """

    def __init__(
        self,
        address: str,
        checked: CheckedGraph,
        folder: Path,
        report: Callable[..., object],
        changed: Callable[[], None],
    ) -> None:
        if not address:
            names = ", ".join(spec.name for spec in checked.expected)
            raise GraphError(f"{names} joins from another host; add --listen tcp://HOST:PORT")
        if checked.clock != "wall":
            raise GraphError(
                f"graph '{checked.graph}' runs in simulated time; only one with clock: wall can be joined"
            )
        self._plan = plan_listening(address, KeyFolder())
        self._folder, self._publish_event, self._changed = folder, report, changed
        self._joined: dict[str, JoinRequest] = {}
        self._liveness = Liveness[str]()
        self._epochs: dict[str, int] = {}
        self._view = view_of(checked)
        self._start_ns: int | None = None
        self._restart_count = 0
        self._show: Callable[[str], None] = lambda _: None
        self._supervisor: Supervisor | None = None
        self._closed = False
        self._sidecar, self.endpoint = self._start_process(self._plan.endpoint)  # where other hosts call

    def _start_process(self, endpoint: str) -> tuple[Sidecar[join_protocol.FromGateway], str]:
        """Start the gateway and show it the graph; return it, and where it listens."""
        log = self._folder / "log" / "gateway.log"
        sidecar = Sidecar("palp_core.graph.network.gateway", _DECODER, log)
        listen_on = join_protocol.ListenOn(
            run_dir=str(self._folder),
            endpoint=endpoint,
            secured=self._plan.secured,
            view=self._view,
            epochs=self._epochs,
            start_ns=self._start_ns,
        )
        with contextlib.ExitStack() as stack:
            stack.callback(sidecar.close)
            try:
                sidecar.send(listen_on)
                if not sidecar.wait(START_TIMEOUT_S):
                    raise GraphError(f"the gateway did not start within {START_TIMEOUT_S:g} s (log: {log})")
                (answer,) = sidecar.receive()
            except ChannelClosed as error:
                raise GraphError(f"the gateway ended while it started (log: {log})") from error
            if isinstance(answer, join_protocol.JoinRefused):
                raise GraphError(answer.text)
            assert isinstance(answer, join_protocol.GatewayEvent)
            stack.pop_all()
        return sidecar, answer.text

    def follow(self, supervisor: Supervisor) -> None:
        """Receive what the gateway sends within the supervisor's loop."""
        self._supervisor = supervisor
        supervisor.watch(self._sidecar.descriptor, self._receive)

    def _forget(self) -> None:
        if self._supervisor is not None:
            self._supervisor.forget(self._sidecar.descriptor)

    def announce_to(self, show: Callable[[str], None]) -> None:
        """Show a person where the gateway listens, what to know of it, and from now on what happens."""
        self._show = show
        show(f"listening on {self.endpoint}")
        for warning in self._plan.warnings:
            show(f"warning: {warning}")
        key = " --server-key KEY" if self._plan.secured else ""
        for spec in self._view.expected.values():
            if spec.name not in self._joined:
                command = f"palp run {spec.run} --name {spec.name} --join {self.endpoint}{key}"
                show(f"/{spec.name} can join; on its host: {command}")

    def _report(self, kind: str, node: str, text: str, **data: object) -> None:
        self._publish_event(kind, node, text, **data)
        self._show(text)

    def described(self, record: RunRecord) -> RunRecord:
        """Return the record of the run with where it is called, and the joined nodes with their endpoints."""
        nodes, topics = list(record.nodes), {entry.name: entry for entry in record.topics}
        for request in self._joined.values():
            publish, serve = endpoints(str(self._folder), request.name)
            nodes.append(NodeEntry(request.name, request.run, 0, publish, serve))
            topics |= {name: info.as_topic(name, publish) for name, info in request.outputs.items()}
        return msgspec.structs.replace(
            record, nodes=nodes, topics=list(topics.values()), listen=self.endpoint
        )

    @property
    def health(self) -> list[NodeHealth]:
        return self._liveness.health

    def report_silence(self) -> None:
        """Report each joined node that is silent, once."""
        for name, silent_ns in self._liveness.unresponsive(monotonic_ns()):
            if text := self._liveness.newly_silent(name, silent_ns):
                self._report("unresponsive", name, f"/{name} {text}", silent_s=silent_ns / 1e9)

    def activate(self, start_ns: int) -> None:
        """Let joined nodes begin; the time is on the host's monotonic clock."""
        self._start_ns = start_ns
        self._send(join_protocol.Active(start_ns=start_ns))

    def _send(self, message: ChannelMessage) -> None:
        try:
            self._sidecar.send(message)
        except ChannelClosed:
            _LOG.debug("the gateway is gone; the supervisor's loop will find out")

    def _receive(self) -> None:
        """Take in what the gateway has sent; start another if it has died."""
        try:
            for message in self._sidecar.receive():
                self._on_message(message)
        except ChannelClosed:
            self._forget()
            self._restart(self._sidecar.close())

    def _on_message(self, message: join_protocol.FromGateway) -> None:
        if isinstance(message, join_protocol.HealthReport):
            if self._liveness.record(message.node, decode(NodeHealth, message.health), monotonic_ns()):
                self._report("responsive", message.node, f"/{message.node}: answers again")
        elif isinstance(message, join_protocol.GatewayEvent):
            if message.request is not None:
                self._joined[message.node] = message.request
                self._epochs[message.node] = int(message.data["epoch"])
                self._liveness.expect(message.node, monotonic_ns())
            self._report(message.kind, message.node, message.text, **message.data)
            if message.request is not None:
                self._changed()
            elif message.kind == "left":
                self._forget_node(message.node, int(message.data["exit_code"]))

    def _forget_node(self, name: str, exit_code: int) -> None:
        del self._joined[name]
        self._liveness.forget(name)
        self._changed()
        expected = self._view.expected.get(name)
        ends = expected is not None and expected.shutdown_on_exit and exit_code >= 0
        if ends and self._supervisor is not None:
            self._supervisor.exit_code = exit_code

    def _restart(self, status: int) -> None:
        text = f"the gateway has died (status {status}); joined nodes are lost, the others go on"
        self._report("failed", "gateway", text, status=status)
        for name in list(self._joined):
            self._report("left", name, f"/{name} has left: the gateway has died", exit_code=-1)
            self._forget_node(name, -1)
        self._restart_count += 1
        if self._restart_count > MOST_RESTARTS or self._closed:
            return
        try:
            self._sidecar, self.endpoint = self._start_process(self.endpoint)
        except GraphError as error:
            self._report("failed", "gateway", f"the gateway cannot be started again: {error}")
            return
        if self._supervisor is not None:
            self._supervisor.watch(self._sidecar.descriptor, self._receive)
        self._report("restarted", "gateway", f"the gateway listens again on {self.endpoint}")

    def close(self, text: str, *, finished: bool) -> None:
        """Tell the joined nodes that the graph ends, ``finished``: by itself; end the gateway."""
        if self._closed:
            return
        self._closed = True
        self._forget()
        self._send(join_protocol.JoinRefused(text=text, finished=finished))
        self._sidecar.close()
