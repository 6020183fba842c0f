"""``palp run``: one node, as a graph of its own or as part of one that runs elsewhere."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.launch_file import find_workspace
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.network import join_protocol
from palp_core.graph.network.address import Address
from palp_core.graph.network.bridge import JoinedGraph
from palp_core.graph.network.joining import join_request, outputs_of, standalone_spec, wired_spec
from palp_core.graph.node.spec import NodeSpec, name_mistake
from palp_core.graph.supervision.fork_server import ForkServer
from palp_core.graph.supervision.interrupt import Interrupt, Interrupted, ended_after
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.supervision.run_record import run_record_of_node
from palp_core.graph.supervision.supervisor import Listeners, Supervisor

Note = Callable[[str], None]


def run_node(
    run: str,
    *,
    name: str | None,
    params: Mapping[str, Any],
    wires: Mapping[str, str],
    address: Address | None,
    note: Note,
) -> int:
    """Run one node until it or its graph ends, and return the exit status."""
    workspace = find_workspace(Path.cwd() / "launch.yaml")
    run, name = _run_and_name(run, name)
    with contextlib.ExitStack() as stack:
        interrupt = stack.enter_context(Interrupt())
        folder = RunDirectory(name)
        stack.callback(folder.release)
        server = ForkServer(interrupt)
        stack.callback(server.close)
        try:
            remote = JoinedGraph(address, folder.path, interrupt) if address is not None else None
            if remote is not None:
                stack.callback(remote.close)
            described = _describe(server, name, run, params, workspace)
            spec = _placed(name, run, params, wires, described, remote, note)
        except BaseException:  # nothing has run: there are no logs to keep
            stack.close()
            folder.remove()
            raise
        launcher_node = stack.enter_context(
            contextlib.closing(LauncherNode(str(folder.path), lambda: _now_ns(supervisor)))
        )

        def announce() -> None:
            """Let this host's tools find the node."""
            topics = outputs_of(spec.name, described, spec.external)
            launcher_node.record = run_record_of_node(spec, topics, folder, supervisor.processes[0].pid)
            folder.write(launcher_node.record)

        def report(health: bytes) -> None:
            if remote is not None:
                remote.send(join_protocol.HealthReport(health=health))

        listeners = Listeners(new_process=announce, health=report)
        supervisor = Supervisor(
            [spec], "wall", str(workspace), folder.path, server, interrupt, launcher_node, listeners
        )
        announce()
        stack.callback(supervisor.close)
        stack.enter_context(ended_after(lambda index: supervisor.shutdown(index, 0), [0]))
        if remote is None:
            supervisor.start()
            announce()
            code = supervisor.run_wall()
        else:
            code = _supervise_joined(supervisor, remote, note)
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
    remote: JoinedGraph | None,
    note: Note,
) -> NodeSpec:
    """Return the node with its place in a graph; ask that graph for it."""
    if remote is None:
        if wires:
            raise GraphError("-r wires a node into a running graph; add --join tcp://HOST:PORT")
        note(f"/{name} runs alone; its inputs take messages from: palp topic pub")
        return standalone_spec(name, run, params, described)
    reached = remote.wait_for(join_protocol.GraphReached)
    view = reached.view
    if view.clock != "wall":
        raise GraphError(
            f"graph '{view.graph}' runs in simulated time; only one with clock: wall can be joined"
        )
    spec = wired_spec(name, run, params, wires, described, view)
    remote.send(join_protocol.Join(request=join_request(spec, described)))
    epoch = remote.wait_for(join_protocol.Joined).epoch
    note(
        f"/{name} has joined graph '{view.graph}'; its clock is known to "
        f"{reached.uncertainty_ns / 1e6:.3f} ms"
    )
    return msgspec.structs.replace(spec, epoch=epoch, shutdown_on_exit=True)


def _run_and_name(run: str, name: str | None) -> tuple[str, str]:
    module, _, class_name = run.rpartition(":")
    if module.endswith(".py"):
        run = f"{Path(module).resolve()}:{class_name}"
    name = name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", class_name).lower()
    if not module:
        raise GraphError(f"cannot run '{run}'; write module:Class or path.py:Class")
    if mistake := name_mistake(name):
        raise GraphError(f"cannot run '{run}': {mistake} with --name")
    return run, name


def _supervise_joined(supervisor: Supervisor, remote: JoinedGraph, note: Note) -> int:
    """Run a node as part of the graph it has joined; return its exit status."""

    def receive() -> None:
        remote.receive()
        if remote.lost is not None:
            supervisor.forget(remote.descriptor)
            supervisor.exit_code = 0 if remote.lost.finished else 1

    supervisor.watch(remote.descriptor, receive)
    try:
        supervisor.start()
        supervisor.wait_until(lambda: remote.start_ns is not None or remote.lost is not None)
        if remote.lost is None:
            code = supervisor.run_wall(start_ns=remote.start_ns)
        else:
            code = 0 if remote.lost.finished else 1
    except (NodeError, Interrupted) as error:
        remote.goodbye = join_protocol.LeaveGraph(text=str(error), exit_code=-1)
        raise
    text = "its work is done" if code == 0 else f"it ended with status {code}"
    remote.goodbye = join_protocol.LeaveGraph(text=text, exit_code=code)
    if remote.lost is not None:
        note(f"{remote.lost.text}; /{supervisor.processes[0].spec.name} goes to its safe state and ends")
    return code
