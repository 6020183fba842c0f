"""The launcher's end of the gateway: started before any node, followed while the graph runs."""

from __future__ import annotations

import logging
import select
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from palp_core.errors import GraphError
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode
from palp_core.graph.network.gateway_messages import (
    Activated,
    Begin,
    CannotListen,
    Ending,
    FromGateway,
    GuestDoes,
    GuestIn,
    GuestOut,
    Listening,
    Opened,
    TurnedAway,
    launcher_decoder,
)
from palp_core.graph.network.join_protocol import GraphView, JoinRequest, NodeView
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.listen_address import Plan, plan
from palp_core.graph.process.channel import ChannelClosed
from palp_core.graph.supervision.sidecar import Companion

START_TIMEOUT_S = 20.0
MOST_RESTARTS = 5
_LOG = logging.getLogger("palp.gateway")


class Loop(Protocol):
    """The supervisor's loop: it calls back, and ends when it has an exit code."""

    exit_code: int | None

    def watch(self, descriptor: int, handle: Callable[[], None]) -> None:
        """Call a function whenever a descriptor can be read."""

    def forget(self, descriptor: int) -> None:
        """Watch it no longer."""


class Tell(Protocol):
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
        nodes=[NodeView(spec.name, spec.run) for spec in checked.spawned],
        topics=checked.topics,
        external={name: checked.topics[name].type_hash for name in external},
        expected={spec.name: spec for spec in checked.expected},
    )


def open_door(
    address: str, checked: CheckedGraph, folder: Path, tell: Tell, changed: Callable[[], None]
) -> Door:
    """Let other hosts call a graph before any of its nodes starts.

    Args:
        address: ``tcp://HOST:PORT``.
        checked: The graph.
        folder: The run directory.
        tell: Publishes an event.
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
    door = Door(address, folder, tell)
    door.changed = changed
    door.open(view_of(checked))
    return door


class Door:
    """A graph's gateway as its launcher sees it.

    Args:
        address: ``tcp://HOST:PORT``.
        folder: The run directory.
        tell: Takes kind, node, text and data of each event: ``joined``, ``left``, ``refused``, ``failed``,
            ``restarted``.
        keys: This host's.

    Attributes:
        endpoint: Where other hosts call, with the port that was chosen.
        warnings: What the user should know.
        guests: Who has joined, by name.
        health: How they do, by their own word.

    Raises:
        SecurityError: Others could reach the address and there are no keys, or they are exposed.
        GraphError: Nobody can listen there.
    """

    def __init__(self, address: str, folder: Path, tell: Tell, keys: KeyFolder | None = None) -> None:
        planned = plan(address, keys or KeyFolder())
        self.warnings = planned.warnings
        self.guests: dict[str, JoinRequest] = {}
        self.changed: Callable[[], None] = lambda: None
        self._plan, self._folder, self._tell = planned, folder, tell
        self.health: dict[str, NodeHealth] = {}
        self._epochs: dict[str, int] = {}
        self._view: GraphView | None = None
        self._start_ns: int | None = None
        self._restart_count = 0
        self._say: Callable[[str], None] = lambda _: None
        self._loop: Loop | None = None
        self._closed = False
        self._companion, self.endpoint = self._begin(planned)

    def _begin(self, planned: Plan) -> tuple[Companion[FromGateway], str]:
        log = self._folder / "log" / "gateway.log"
        companion = Companion("palp_core.graph.network.gateway", launcher_decoder(), log)
        try:
            companion.send(Begin(str(self._folder), planned.endpoint, planned.secured, self._epochs))
            if not select.select((companion.descriptor,), (), (), START_TIMEOUT_S)[0]:
                raise GraphError(f"the gateway did not start within {START_TIMEOUT_S:g} s (log: {log})")
            (said,) = companion.news()
        except (ChannelClosed, GraphError) as error:
            companion.close()
            if isinstance(error, GraphError):
                raise
            raise GraphError(f"the gateway ended while it started (log: {log})") from error
        if isinstance(said, CannotListen):
            companion.close()
            raise GraphError(said.text)
        assert isinstance(said, Listening)
        return companion, said.endpoint

    def follow(self, loop: Loop) -> None:
        """Let the supervisor's loop tell when the gateway has said something."""
        self._loop = loop
        loop.watch(self._companion.descriptor, self.attend)

    def _forget(self) -> None:
        if self._loop is not None:
            self._loop.forget(self._companion.descriptor)

    def speak(self, say: Callable[[str], None]) -> None:
        """Show a person where the gateway listens, what to know of it, and from now on what happens."""
        self._say = say
        say(f"listening on {self.endpoint}")
        for warning in self.warnings:
            say(f"warning: {warning}")
        for spec in self._view.expected.values() if self._view is not None else ():
            if spec.name not in self.guests:
                key = " --server-key KEY" if self._plan.secured else ""
                say(
                    f"/{spec.name} is to join; on its host: palp run {spec.run} --name {spec.name} "
                    f"--join {self.endpoint}{key}"
                )

    def _report(self, kind: str, node: str, text: str, **data: object) -> None:
        self._tell(kind, node, text, **data)
        self._say(text)

    def open(self, view: GraphView) -> None:
        """Show the graph to those who call; again when it has changed."""
        self._view = view
        self._send(Opened(view))

    def activate(self, start_ns: int) -> None:
        """Let joined nodes begin: the graph runs since then on the host's monotonic clock."""
        self._start_ns = start_ns
        self._send(Activated(start_ns))

    def _send(self, line: Opened | Activated | Ending) -> None:
        try:
            self._companion.send(line)
        except ChannelClosed:
            _LOG.debug("the gateway is gone; attend() will find out")

    def attend(self) -> None:
        """Take in what the gateway has said; start another if it has died."""
        try:
            for said in self._companion.news():
                self._on_line(said)
        except ChannelClosed:
            self._forget()
            self._mourn(self._companion.close())
            if self._restart_count < MOST_RESTARTS and not self._closed:
                self._restart()

    def _on_line(self, said: FromGateway) -> None:
        if isinstance(said, GuestIn):
            request = said.request
            self.guests[request.name] = request
            self._epochs[request.name] = said.epoch
            text = f"/{request.name} has joined from {request.host}"
            where = {"run": request.run, "host": request.host, "address": said.address}
            self._report("joined", request.name, text, **where, epoch=said.epoch)
            self.changed()
        elif isinstance(said, GuestOut):
            self.guests.pop(said.name, None)
            self.health.pop(said.name, None)
            self._report("left", said.name, f"/{said.name} has left: {said.text}", exit_code=said.exit_code)
            self.changed()
            expected = self._view.expected.get(said.name) if self._view is not None else None
            ends = expected is not None and expected.shutdown_on_exit and said.exit_code >= 0
            if ends and self._loop is not None:
                self._loop.exit_code = said.exit_code
        elif isinstance(said, GuestDoes):
            self.health[said.name] = decode(NodeHealth, said.health)
        elif isinstance(said, TurnedAway):
            self._report("refused", "", said.text, address=said.address, key=said.key, count=said.count)

    def _mourn(self, status: int) -> None:
        text = f"the gateway has died (status {status}); joined nodes are lost, the others go on"
        self._report("failed", "gateway", text, status=status)
        self.health.clear()
        for name in list(self.guests):
            del self.guests[name]
            self._report("left", name, f"/{name} has left: the gateway has died", exit_code=-1)
        self.changed()

    def _restart(self) -> None:
        self._restart_count += 1
        again = self._plan._replace(endpoint=self.endpoint)
        try:
            self._companion, self.endpoint = self._begin(again)
        except GraphError as error:
            self._report("failed", "gateway", f"the gateway cannot be started again: {error}")
            return
        if self._loop is not None:
            self._loop.watch(self._companion.descriptor, self.attend)
        if self._view is not None:
            self._send(Opened(self._view))
        if self._start_ns is not None:
            self._send(Activated(self._start_ns))
        self._report("restarted", "gateway", f"the gateway listens again on {self.endpoint}")

    def close(self, text: str, *, finished: bool) -> None:
        """Tell every guest that the graph ends, ``finished`` if it has come to its end; end the gateway."""
        if self._closed:
            return
        self._closed = True
        self._forget()
        self._send(Ending(text, finished))
        self._companion.close()
