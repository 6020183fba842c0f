"""``palp run``: one node, as a graph of its own or as part of one that runs elsewhere."""

from __future__ import annotations

import contextlib
import re
import select
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import GraphError, NodeError, SecurityError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.launch_file import find_workspace
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.network import bridge_messages
from palp_core.graph.network.join_wiring import join_request, outputs_of, standalone_spec, wired_spec
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.listen_address import host_and_port, resolve
from palp_core.graph.node.spec import NodeSpec, name_mistake
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage
from palp_core.graph.supervision.fork_server import ForkServer
from palp_core.graph.supervision.interrupt import Interrupt, Interrupted, ended_after
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.supervision.run_record import run_record_of_node
from palp_core.graph.supervision.sidecar import Sidecar
from palp_core.graph.supervision.supervisor import Supervisor

Say = Callable[[str], None]


class Address(msgspec.Struct, frozen=True):
    """Where a graph is called; without CURVE the key is ""."""

    endpoint: str
    server_key: str

    @classmethod
    def of(cls, endpoint: str, server_key: str | None, keys: KeyFolder) -> Address:
        """Find the keys for a call.

        Args:
            endpoint: ``tcp://HOST:PORT``.
            server_key: The gateway's public key, a file that holds it, or the name of an allowed host.
            keys: This host's.

        Raises:
            SecurityError: Not an address, or the keys it takes are not there.
        """
        host, _ = host_and_port(endpoint)
        number = resolve(host, endpoint)
        if server_key is None:
            if not number.is_loopback:
                raise SecurityError(
                    f"{endpoint} is another host: give its public key with --server-key KEY or FILE; it is "
                    "shown there by: palp keys list"
                )
            return cls(endpoint, "")
        own, key = keys.own(), keys.find(server_key)
        if own is None:
            raise SecurityError(
                f"this host has no keys in {keys.path}; make a pair: palp keys generate; then, where the "
                "graph runs: palp keys allow FILE"
            )
        return cls(endpoint, key)


class _BridgeHandle:
    """The bridge to a graph elsewhere, as this process sees it."""

    def __init__(self, address: Address, folder: Path, interrupt: Interrupt) -> None:
        self._interrupt = interrupt
        self._bridge: Sidecar[bridge_messages.FromBridge] = Sidecar(
            "palp_core.graph.network.bridge", bridge_messages.joiner_decoder(), folder / "log" / "bridge.log"
        )
        self._said: list[bridge_messages.FromBridge] = []
        self.start_ns: int | None = None
        self.lost: bridge_messages.ConnectionLost | None = None
        self.goodbye = bridge_messages.Goodbye("it could not start", -1)
        self._send(bridge_messages.CallGateway(address.endpoint, address.server_key, str(folder)))

    def _send(self, message: ChannelMessage) -> None:
        with contextlib.suppress(ChannelClosed):
            self._bridge.send(message)

    def report_health(self, health: bytes) -> None:
        """Tell how the node does; a bridge that does not take it keeps nobody waiting."""
        if select.select((), (self.descriptor,), (), 0.0)[1]:
            self._send(bridge_messages.HealthChanged(health))

    @property
    def descriptor(self) -> int:
        return self._bridge.descriptor

    def receive(self) -> None:
        """Take in what it has said."""
        try:
            self._said += self._bridge.receive()
        except ChannelClosed:
            self._said.append(
                bridge_messages.ConnectionLost("the bridge to the graph has died", finished=False)
            )
        for said in self._said:
            if isinstance(said, bridge_messages.GraphStarted):
                self.start_ns = said.start_ns
            elif isinstance(said, bridge_messages.ConnectionLost) and self.lost is None:
                self.lost = said

    def wait_for(self, kind: type[bridge_messages.GraphReached] | type[bridge_messages.Admitted]) -> Any:
        """Wait for a message of a kind.

        Raises:
            GraphError: The graph cannot be reached or refuses.
            Interrupted: The user asked for the end.
        """
        while True:
            for said in self._said:
                if isinstance(said, kind):
                    return said
            self.raise_if_lost()
            select.select((self.descriptor, self._interrupt.descriptor), (), ())
            self._interrupt.check()
            self.receive()

    def raise_if_lost(self) -> None:
        if self.lost is not None:
            raise GraphError(self.lost.text)

    def ask_to_join(self, spec: NodeSpec, feeds: dict[str, str], described: NodeClass) -> int:
        """Ask to be let in; return the epoch from which the node counts."""
        self._send(bridge_messages.AskToJoin(join_request(spec, feeds, described)))
        admitted: bridge_messages.Admitted = self.wait_for(bridge_messages.Admitted)
        return admitted.epoch

    def close(self) -> None:
        """Say goodbye and end the bridge."""
        self._send(self.goodbye)
        self._bridge.close()


def run_node(
    run: str,
    *,
    name: str | None,
    params: Mapping[str, Any],
    wires: Mapping[str, str],
    address: Address | None,
    say: Say,
) -> int:
    """Run one node until it or its graph ends, and return the exit status.

    Args:
        run: ``module:Class``, or ``path.py:Class``.
        name: Running name; by default the class's, in lower case with underscores.
        params: By name.
        wires: Topic by port; see :func:`palp_core.graph.network.join_wiring.wired_spec`.
        address: Of the graph to join; None: the node runs alone, on the machine's clock.
        say: Shows a line to the user.

    Raises:
        PalpError: The node cannot run, or the graph cannot be joined.
        Interrupted: The user asked for the end.
    """
    workspace = find_workspace(Path.cwd() / "launch.yaml")
    run, name = _run_and_name(run, name)
    with contextlib.ExitStack() as stack:
        interrupt = stack.enter_context(Interrupt())
        folder = RunDirectory(name)
        stack.callback(folder.release)
        server = ForkServer(interrupt)
        stack.callback(server.close)
        try:
            remote = _BridgeHandle(address, folder.path, interrupt) if address is not None else None
            if remote is not None:
                stack.callback(remote.close)
            described = _describe(server, name, run, params, workspace)
            spec = _placed(name, run, params, wires, described, remote, say)
        except BaseException:  # nothing has run: there are no logs to keep
            stack.close()
            folder.remove()
            raise
        launcher_node = stack.enter_context(
            contextlib.closing(LauncherNode(str(folder.path), lambda: _now_ns(supervisor)))
        )
        supervisor = Supervisor(
            [spec], "wall", str(workspace), folder.path, server, interrupt, lambda *_: None, launcher_node
        )

        def announce() -> None:
            """Let this host's tools find the node."""
            topics = outputs_of(spec.name, described, spec.external)
            launcher_node.record = run_record_of_node(spec, topics, folder, supervisor.processes[0].pid)
            folder.write(launcher_node.record)

        announce()
        supervisor.on_new_process = announce
        stack.callback(supervisor.close)
        stack.enter_context(ended_after(lambda index: supervisor.shutdown(index, 0), [0]))
        code = _supervise(supervisor) if remote is None else _supervise_joined(supervisor, remote, say)
    if code == 0:
        folder.remove()
    return code


def _now_ns(supervisor: Supervisor) -> int:
    return monotonic_ns() - supervisor.start_ns if supervisor.start_ns else 0


def _describe(
    server: ForkServer, name: str, run: str, params: Mapping[str, Any], workspace: Path
) -> NodeClass:
    (described,) = server.inspect_classes([NodeClassRequest(run, dict(params), name=name)], workspace)
    problems = [described.error] if described.error else list(described.param_errors.values())
    if problems:
        raise GraphError(f"{run}: " + "; ".join(problems))
    return described


def _placed(
    name: str,
    run: str,
    params: Mapping[str, Any],
    wires: Mapping[str, str],
    described: NodeClass,
    remote: _BridgeHandle | None,
    say: Say,
) -> NodeSpec:
    """Return the node with its place in a graph; ask that graph for it."""
    if remote is None:
        if wires:
            raise GraphError("-r wires a node into a running graph; add --join tcp://HOST:PORT")
        say(f"/{name} runs alone; its inputs take messages from: palp topic pub")
        return standalone_spec(name, run, params, described)
    reached: bridge_messages.GraphReached = remote.wait_for(bridge_messages.GraphReached)
    view = reached.view
    if view.clock != "wall":
        raise GraphError(
            f"graph '{view.graph}' runs in simulated time; only one with clock: wall can be joined"
        )
    spec, feeds = wired_spec(name, run, params, wires, described, view)
    epoch = remote.ask_to_join(spec, feeds, described)
    say(
        f"/{name} has joined graph '{view.graph}'; its clock is known to "
        f"{reached.uncertainty_ns / 1e6:.3f} ms"
    )
    return msgspec.structs.replace(spec, epoch=epoch, shutdown_on_exit=True)


def _run_and_name(run: str, name: str | None) -> tuple[str, str]:
    """Return what to run, with the whole path of a file, and the running name.

    Raises:
        GraphError: Neither ``module:Class`` nor ``path.py:Class``, or not a node's name.
    """
    module, _, class_name = run.rpartition(":")
    if module.endswith(".py"):
        run = f"{Path(module).resolve()}:{class_name}"
    name = name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", class_name).lower()
    if not module:
        raise GraphError(f"cannot run '{run}'; write module:Class or path.py:Class")
    if mistake := name_mistake(name):
        raise GraphError(f"cannot run '{run}': {mistake} with --name")
    return run, name


def _supervise(supervisor: Supervisor) -> int:
    """Run a node that is alone; return its exit status."""
    supervisor.start()
    supervisor.on_new_process()
    return supervisor.run_wall()


def _supervise_joined(supervisor: Supervisor, remote: _BridgeHandle, say: Say) -> int:
    """Run a node as part of the graph it has joined; return its exit status, and leave what to say there."""
    try:
        code = _run_joined(supervisor, remote)
    except (NodeError, Interrupted) as error:
        remote.goodbye = bridge_messages.Goodbye(str(error), -1)
        raise
    remote.goodbye = bridge_messages.Goodbye(
        "its work is done" if code == 0 else f"it ended with status {code}", code
    )
    if remote.lost is not None:
        say(f"{remote.lost.text}; /{supervisor.processes[0].spec.name} goes to its safe state and ends")
    return code


def _run_joined(supervisor: Supervisor, remote: _BridgeHandle) -> int:
    def receive() -> None:
        remote.receive()
        if remote.lost is not None:
            supervisor.forget(remote.descriptor)
            supervisor.exit_code = 0 if remote.lost.finished else 1

    supervisor.on_health = remote.report_health
    supervisor.watch(remote.descriptor, receive)
    supervisor.start()
    supervisor.wait_until(lambda: remote.start_ns is not None or remote.lost is not None)
    if remote.lost is not None:
        return 0 if remote.lost.finished else 1
    return supervisor.run_wall(start_ns=remote.start_ns)
