"""The launcher's end of the gateway: started before any node, followed while the graph runs."""

from __future__ import annotations

import logging
import select
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode
from palp_core.graph.network import join_protocol
from palp_core.graph.network.address import ListenPlan, plan_listening
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


class Report(Protocol):
    """Publishes an event of the graph."""

    def __call__(self, kind: str, node: str, text: str, /, **data: object) -> object: ...


def view_of(checked: CheckedGraph) -> GraphView:
    """Return a graph as other hosts see it."""
    external = [
        reading.topic
        for readings in checked.readings.values()
        for reading in readings.values()
        if reading.external
    ]
    return GraphView(
        graph=checked.graph,
        clock=checked.clock,
        nodes=[spec.name for spec in checked.spawned],
        topics=checked.topics,
        external={name: checked.topics[name].type_hash for name in external},
        expected={spec.name: spec for spec in checked.expected},
    )


def open_gateway(
    address: str, checked: CheckedGraph, folder: Path, report: Report, changed: Callable[[], None]
) -> GatewayHandle:
    """Let other hosts call a graph before any of its nodes starts.

    Args:
        address: ``tcp://HOST:PORT``.
        checked: The graph.
        folder: The run directory.
        report: Publishes an event.
        changed: Is called when somebody has joined or left.

    Raises:
        SecurityError: Others could reach the address and there are no keys, or they are exposed.
        GraphError: Nobody can listen there, or the graph runs in simulated time.
    """
    if not address:
        names = ", ".join(spec.name for spec in checked.expected)
        raise GraphError(f"{names} joins from another host; say where it can: --listen tcp://HOST:PORT")
    if checked.clock != "wall":
        raise GraphError(
            f"graph '{checked.graph}' runs in simulated time; only one with clock: wall can be joined"
        )
    gateway = GatewayHandle(address, folder, report)
    gateway.changed = changed
    gateway.show(view_of(checked))
    return gateway


class GatewayHandle:
    """A graph's gateway as its launcher sees it.

    Args:
        address: ``tcp://HOST:PORT``.
        folder: The run directory.
        report: Takes kind, node, text and data of each event: ``joined``, ``left``, ``refused``, ``failed``,
            ``restarted``.
        keys: This host's.

    Attributes:
        endpoint: Where other hosts call, with the port that was chosen.
        warnings: What the user should know.
        joined: Who has joined, by name.

    Raises:
        SecurityError: Others could reach the address and there are no keys, or they are exposed.
        GraphError: Nobody can listen there.
    """

    def __init__(self, address: str, folder: Path, report: Report, keys: KeyFolder | None = None) -> None:
        planned = plan_listening(address, keys or KeyFolder())
        self.warnings = planned.warnings
        self.joined: dict[str, JoinRequest] = {}
        self.changed: Callable[[], None] = lambda: None
        self._plan, self._folder, self._publish_event = planned, folder, report
        self._liveness = Liveness[str]()
        self._epochs: dict[str, int] = {}
        self._view: GraphView | None = None
        self._start_ns: int | None = None
        self._restart_count = 0
        self._say: Callable[[str], None] = lambda _: None
        self._supervisor: Supervisor | None = None
        self._closed = False
        self._sidecar, self.endpoint = self._start_process(planned)

    def _start_process(self, planned: ListenPlan) -> tuple[Sidecar[join_protocol.FromGateway], str]:
        log = self._folder / "log" / "gateway.log"
        sidecar = Sidecar("palp_core.graph.network.gateway", _DECODER, log)
        try:
            sidecar.send(
                join_protocol.ListenOn(
                    run_dir=str(self._folder),
                    endpoint=planned.endpoint,
                    secured=planned.secured,
                    epochs=self._epochs,
                )
            )
            if not select.select((sidecar.descriptor,), (), (), START_TIMEOUT_S)[0]:
                raise GraphError(f"the gateway did not start within {START_TIMEOUT_S:g} s (log: {log})")
            (answer,) = sidecar.receive()
            if isinstance(answer, join_protocol.Listening):
                return sidecar, answer.endpoint
            raise GraphError(getattr(answer, "text", ""))
        except (ChannelClosed, GraphError) as error:
            sidecar.close()
            if isinstance(error, GraphError):
                raise
            raise GraphError(f"the gateway ended while it started (log: {log})") from error

    def follow(self, supervisor: Supervisor) -> None:
        """Receive what the gateway sends within the supervisor's loop."""
        self._supervisor = supervisor
        supervisor.watch(self._sidecar.descriptor, self._receive)

    def _forget(self) -> None:
        if self._supervisor is not None:
            self._supervisor.forget(self._sidecar.descriptor)

    def announce_to(self, say: Callable[[str], None]) -> None:
        """Show a person where the gateway listens, what to know of it, and from now on what happens."""
        self._say = say
        say(f"listening on {self.endpoint}")
        for warning in self.warnings:
            say(f"warning: {warning}")
        for spec in self._view.expected.values() if self._view is not None else ():
            if spec.name not in self.joined:
                key = " --server-key KEY" if self._plan.secured else ""
                say(
                    f"/{spec.name} is to join; on its host: palp run {spec.run} --name {spec.name} "
                    f"--join {self.endpoint}{key}"
                )

    def _report(self, kind: str, node: str, text: str, **data: object) -> None:
        self._publish_event(kind, node, text, **data)
        self._say(text)

    def show(self, view: GraphView) -> None:
        """Show the graph to those who call; again when it has changed."""
        self._view = view
        self._send(join_protocol.GraphUpdate(view=view))

    def described(self, record: RunRecord) -> RunRecord:
        """Return the record of the run with where it is called and who has joined it.

        Those who have joined have endpoints in the run directory, as any other node.
        """
        nodes, topics = list(record.nodes), {entry.name: entry for entry in record.topics}
        for request in self.joined.values():
            publish, serve = endpoints(str(self._folder), request.name)
            nodes.append(NodeEntry(request.name, request.run, 0, publish, serve))
            topics |= {name: info.as_topic(name, publish) for name, info in request.outputs.items()}
        return msgspec.structs.replace(
            record, nodes=nodes, topics=list(topics.values()), listen=self.endpoint
        )

    @property
    def health(self) -> list[NodeHealth]:
        """How those do that have joined, as they report it."""
        return self._liveness.health

    def report_silence(self) -> None:
        """Say of each that has joined and is silent that it is, once."""
        for name, silent_ns in self._liveness.unresponsive(monotonic_ns()):
            if text := self._liveness.newly_silent(name, silent_ns):
                self._report("unresponsive", name, f"/{name} {text}", silent_s=silent_ns / 1e9)

    def activate(self, start_ns: int) -> None:
        """Let joined nodes begin: the graph runs since then on the host's monotonic clock."""
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
            self._report_death(self._sidecar.close())
            if self._restart_count < MOST_RESTARTS and not self._closed:
                self._restart()

    def _on_message(self, message: join_protocol.FromGateway) -> None:
        if isinstance(message, join_protocol.NodeJoined):
            request = message.request
            self.joined[request.name] = request
            self._epochs[request.name] = message.epoch
            self._liveness.expect(request.name, monotonic_ns())
            text = f"/{request.name} has joined from {request.host}"
            where = {"run": request.run, "host": request.host, "address": message.address}
            self._report("joined", request.name, text, **where, epoch=message.epoch)
            self.changed()
        elif isinstance(message, join_protocol.NodeLeft):
            self.joined.pop(message.name, None)
            self._liveness.forget(message.name)
            self._report(
                "left", message.name, f"/{message.name} has left: {message.text}", exit_code=message.exit_code
            )
            self.changed()
            expected = self._view.expected.get(message.name) if self._view is not None else None
            ends = expected is not None and expected.shutdown_on_exit and message.exit_code >= 0
            if ends and self._supervisor is not None:
                self._supervisor.exit_code = message.exit_code
        elif isinstance(message, join_protocol.NodeReported):
            if self._liveness.heard(message.name, decode(NodeHealth, message.health), monotonic_ns()):
                self._report("responsive", message.name, f"/{message.name}: answers again")
        elif isinstance(message, join_protocol.PeerRejected):
            self._report(
                "refused", "", message.text, address=message.address, key=message.key, count=message.count
            )

    def _report_death(self, status: int) -> None:
        text = f"the gateway has died (status {status}); joined nodes are lost, the others go on"
        self._report("failed", "gateway", text, status=status)
        for name in list(self.joined):
            del self.joined[name]
            self._liveness.forget(name)
            self._report("left", name, f"/{name} has left: the gateway has died", exit_code=-1)
        self.changed()

    def _restart(self) -> None:
        self._restart_count += 1
        again = self._plan._replace(endpoint=self.endpoint)
        try:
            self._sidecar, self.endpoint = self._start_process(again)
        except GraphError as error:
            self._report("failed", "gateway", f"the gateway cannot be started again: {error}")
            return
        if self._supervisor is not None:
            self._supervisor.watch(self._sidecar.descriptor, self._receive)
        if self._view is not None:
            self._send(join_protocol.GraphUpdate(view=self._view))
        if self._start_ns is not None:
            self._send(join_protocol.Active(start_ns=self._start_ns))
        self._report("restarted", "gateway", f"the gateway listens again on {self.endpoint}")

    def close(self, text: str, *, finished: bool) -> None:
        """Tell who has joined that the graph ends, ``finished``: by itself; end the gateway."""
        if self._closed:
            return
        self._closed = True
        self._forget()
        self._send(join_protocol.JoinRefused(text=text, finished=finished))
        self._sidecar.close()
