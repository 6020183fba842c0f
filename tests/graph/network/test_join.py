"""Nodes of another host in a running graph: they read, publish and end as any other."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator

import psutil
import pytest

from palp_core.graph.messages.builtin import GraphEvent
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from tests.support.hosts import Host, Launched, NoteBook, joining, own_host, trusting
from tests.support.palp import PATIENCE_S, finished


@pytest.fixture
def home() -> Iterator[Host]:
    with own_host() as host:
        yield host


@pytest.fixture
def away(home: Host) -> Iterator[Host]:
    with own_host() as host:
        trusting(home, host)
        yield host


@pytest.fixture(scope="module")
def open_home() -> Iterator[Host]:
    """The host of a graph that every guest leaves as it was."""
    with own_host() as host:
        host.keys.generate("home")
        yield host


@pytest.fixture(scope="module")
def open_graph(open_home: Host) -> Launched:
    return open_home.launch()


@pytest.fixture
def visitor(open_home: Host, open_graph: Launched) -> Iterator[Host]:
    """A host that the open graph lets in, whose guests have left when the next one comes."""
    with own_host() as host:
        open_home.keys.allow(host.keys.generate("away").public, host.folder.name)
        yield host
    while open_graph.ask("gateway", op="guests")["guests"]:
        pass


def keeper(home: Host, graph: Launched, book: NoteBook, *more: object) -> list[object]:
    """A node away that writes down what the ticker at home says."""
    wires = ("-r", "tick:=/ticker/tick", "-p", f"notes:={book.path}")
    return joining(home, graph, "nodes.toys:Keeper", "--name", "guest", *wires, *more)


def node_process(host: Host, parent: str) -> psutil.Process:
    """The process of the node itself: a child of the fork server."""
    (found,) = (child for process in host.running(parent) for child in process.children())
    return found


def test_a_node_of_another_host_reads_every_message_on_the_graphs_clock(home: Host, away: Host) -> None:
    graph, book = home.launch(), away.book()
    guest = away.start(*keeper(home, graph, book))
    book.until("active")
    ticks = [book.until("tick") for _ in range(100)]
    indices = [int(tick[1]) for tick in ticks]
    assert indices == list(range(indices[0], indices[0] + 100))
    delays_s = [(int(now_ns) - int(sent_ns)) / 1e9 for _, _, sent_ns, now_ns in ticks]
    assert graph.end() == 128 + signal.SIGTERM
    status, said = finished(guest)
    known = re.search(r"its clock is known to ([\d.]+) ms", said)
    assert known is not None
    assert min(delays_s) >= -(float(known[1]) + 0.001) / 1e3, "its clock is not the graph's"
    assert status == 1
    book.until("safe")
    assert away.all_gone()
    assert home.all_gone()


def test_tools_of_the_graphs_host_use_a_joined_node_as_any_other(
    open_home: Host, open_graph: Launched, visitor: Host
) -> None:
    graph, book = open_graph, visitor.book()
    visitor.start(*keeper(open_home, graph, book))
    graph.said("/guest has joined")
    book.until("tick")
    record = graph.record()
    assert "guest" in [node["name"] for node in record["nodes"]]
    assert record["listen"] == graph.address
    echoed = open_home.run("topic", "echo", "/guest/heard", "--once", "--json")
    assert echoed.returncode == 0, echoed.stderr
    assert '"index"' in echoed.stdout
    info = graph.ask("guest", op="info")
    assert info["name"] == "guest"
    assert info["inputs"]["/ticker/tick"]["lost"] == 0
    assert graph.ask("guest", op="no_such")["error"]
    active = "len(m.nodes) == 3 and m.nodes[2].lifecycle == 'active'"
    echoed = open_home.run("topic", "echo", "/graph/health", "--json", "--once", "--filter", active)
    (does,) = [node for node in json.loads(echoed.stdout)["nodes"] if node["node"] == "guest"]
    assert (does["pid"], does["lifecycle"]) == (0, "active")
    assert does["memory_bytes"] > 0
    assert [edge["topic"] for edge in does["edges"]] == ["/ticker/tick"]
    history = graph.ask("graph", op="history", topic="/graph/events", first=1, last=100)
    events = [decode(GraphEvent, parse(frame).payload) for frame in history["frames"]]
    (joined,) = [event for event in events if (event.kind, event.node) == ("joined", "guest")]
    assert json.loads(joined.data)["address"] == "127.0.0.1"


def test_a_joined_nodes_output_goes_into_a_port_declared_external(
    open_home: Host, open_graph: Launched, visitor: Host
) -> None:
    wires = ("-r", "tick:=/keeper/tick", "--name", "metronome", "-p", "rate_hz:=50.0")
    visitor.start(*joining(open_home, open_graph, "nodes.toys:Ticker", *wires))
    ticks = [open_graph.book.until("tick") for _ in range(20)]
    indices = [int(tick[1]) for tick in ticks]
    assert indices == list(range(1, 21))


def test_a_large_message_crosses_whole(home: Host, away: Host) -> None:
    graph, book = home.launch("size:=300000", "rate_hz:=20.0"), away.book()
    away.start(*keeper(home, graph, book))
    indices = [int(book.until("tick")[1]) for _ in range(20)]
    assert indices == list(range(indices[0], indices[0] + 20))


def test_two_guests_hear_each_other(open_home: Host, open_graph: Launched, visitor: Host) -> None:
    graph, book = open_graph, visitor.book()
    visitor.start(*joining(open_home, graph, "nodes.toys:Ticker", "--name", "drummer"))
    graph.said("/drummer has joined")
    wires = ("-r", "tick:=/drummer/tick", "-p", f"notes:={book.path}")
    visitor.start(*joining(open_home, graph, "nodes.toys:Keeper", "--name", "second", *wires))
    book.until("tick")


MISFITS = [
    (("nodes.toys:Keeper", "--name", "ticker", "-r", "tick:=/ticker/tick"), "a node 'ticker' is in graph"),
    (("nodes.toys:Keeper", "--name", "graph", "-r", "tick:=/ticker/tick"), "the launcher's own"),
    (("nodes.toys:Keeper", "-r", "tick:=/ticker/tikc"), "did you mean '/ticker/tick'"),
    (("nodes.toys:Keeper", "-r", "tick:=/keeper/heard"), "/keeper/heard carries Tock, not Tick"),
    (("nodes.toys:Keeper",), "add -r tick:=/ticker/tick"),
    (("nodes.toys:Keeper", "-r", "tock:=/ticker/tick"), "has no port 'tock'"),
    (("nodes.toys:Ticker", "-r", "tick:=/keeper/tock"), "no port that graph 'home' declares external"),
    (("nodes.toys:Ticker", "-p", "rate:=5.0"), "did you mean 'rate_hz'"),
    (("nodes.toys:Tikcer",), "did you mean 'Ticker'"),
]


def test_what_does_not_fit_is_refused_with_the_reason(
    open_home: Host, open_graph: Launched, visitor: Host
) -> None:
    visitors = []
    for arguments, _ in MISFITS:
        name = () if "--name" in arguments else ("--name", "visitor")
        visitors.append(visitor.start(*joining(open_home, open_graph, *arguments, *name)))
    for process, (_, words) in zip(visitors, MISFITS, strict=True):
        status, said = finished(process)
        assert status == 2
        assert words in said
        assert "Traceback" not in said
    assert visitor.all_gone()
    assert open_graph.process.poll() is None


def test_a_guest_that_is_killed_leaves_and_its_name_is_free_again(home: Host, away: Host) -> None:
    graph, book = home.launch(), away.book()
    guest = away.start(*keeper(home, graph, book))
    book.until("tick")
    node_process(away, "fork_server").kill()
    status, said = finished(guest)
    assert status == 1
    assert "SIGKILL" in said
    assert "left" in graph.said("/guest has left")
    again = away.start(*keeper(home, graph, book))
    book.until("active")
    book.until("tick")
    os.kill(again.pid, signal.SIGKILL)
    graph.said("/guest has left")
    assert away.all_gone()
    third = away.start(*keeper(home, graph, book))
    book.until("active")
    assert third.poll() is None
    assert "guest" in [node["name"] for node in graph.record()["nodes"]]


def test_when_the_gateway_dies_the_guest_is_safe_the_graph_goes_on_and_can_be_joined_again(
    home: Host, away: Host
) -> None:
    graph, book = home.launch(), away.book()
    guest = away.start(*keeper(home, graph, book))
    book.until("tick")
    graph.gateway().kill()
    status, said = finished(guest)
    assert status == 1
    assert "has ended" in said
    book.until("safe")
    graph.said("the gateway listens again")
    assert graph.ask("ticker", op="info")["lifecycle"] == "active"
    away.start(*keeper(home, graph, book))
    book.until("active")
    book.until("tick")


def test_when_the_graph_is_killed_nothing_remains_and_the_guest_is_safe(home: Host, away: Host) -> None:
    graph, book = home.launch(), away.book()
    guest = away.start(*keeper(home, graph, book))
    book.until("tick")
    graph.process.kill()
    status, _ = finished(guest)
    assert status == 1
    book.until("safe")
    assert home.all_gone()
    assert away.all_gone()


def test_ctrl_c_brings_a_guest_to_its_safe_state_and_the_graph_hears_of_it(home: Host, away: Host) -> None:
    graph, book = home.launch(), away.book()
    guest = away.start(*keeper(home, graph, book))
    book.until("tick")
    guest.send_signal(signal.SIGINT)
    status, said = finished(guest)
    assert status == 130
    assert "the node has ended" in said
    book.until("safe")
    graph.said("/guest has left")


@pytest.mark.nightly
def test_a_gateway_that_hangs_counts_as_dead(home: Host, away: Host) -> None:
    graph, book = home.launch(), away.book()
    guest = away.start(*keeper(home, graph, book))
    book.until("tick")
    hanging = graph.gateway()
    hanging.suspend()
    status, said = finished(guest)
    hanging.resume()
    assert status == 1
    assert "not heard any more" in said
    book.until("safe")


def test_a_graph_in_simulated_time_cannot_be_joined(home: Host) -> None:
    text = home.file.read_text().replace("clock: wall", "clock: sim")
    home.file.write_text(text)
    done = home.run("launch", home.file, "--listen", "tcp://127.0.0.1:0")
    assert done.returncode == 2
    assert "only one with clock: wall can be joined" in done.stderr


def test_a_node_runs_alone_and_takes_messages_from_outside(home: Host) -> None:
    book = home.book()
    standalone_spec = home.start("run", "nodes.toys:Keeper", "-p", f"notes:={book.path}")
    book.until("active")
    graph = Launched.__new__(Launched)
    graph.host = home
    assert graph.ask("keeper", op="publish", port="tick", message={"index": 7})["sequence"] == 1
    assert book.until("tick")[1] == "7"
    (entry,) = graph.record()["nodes"]
    assert psutil.pid_exists(entry["pid"])
    assert "/keeper/tick" in home.run("topic", "list").stdout
    standalone_spec.send_signal(signal.SIGINT)
    assert finished(standalone_spec)[0] == 130
    book.until("safe")
    assert home.all_gone()


EXPECTING = """
graph: home
clock: wall
args:
  notes: {default: "", help: of the keeper}
nodes:
  metronome: {run: "nodes.toys:Ticker", params: {rate_hz: 50.0}, joined: true}
  keeper:
    run: nodes.toys:Keeper
    params: {notes: $(var notes)}
    inputs: {tick: metronome/tick}
"""


def test_a_node_that_the_launch_file_expects_joins_with_its_wires_and_params(home: Host, away: Host) -> None:
    home.file.write_text(EXPECTING)
    graph = home.launch()  # it does not wait
    assert "palp run nodes.toys:Ticker --name metronome --join" in graph.said("/metronome is to join")
    metronome = away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "metronome"))
    indices = [int(graph.book.until("tick")[1]) for _ in range(20)]
    assert indices == list(range(1, 21))
    assert graph.ask("metronome", op="info")["params"]["rate_hz"] == 50.0
    metronome.kill()
    graph.said("/metronome has left")
    assert "has not joined" in graph.ask("metronome", op="info")["error"]
    away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "metronome"))
    while int(graph.book.until("tick")[1]) != 1:
        pass
    accounts = graph.ask("keeper", op="info")["inputs"]["/metronome/tick"]
    assert accounts["lost"] == 0
    assert accounts["epoch"] == 2
    wrong = away.run(
        *joining(home, graph, "nodes.toys:Keeper", "--name", "metronome", "-r", "tick:=/keeper/heard")
    )
    assert wrong.returncode == 2


def test_a_graph_that_expects_somebody_says_where_only_if_it_listens(home: Host) -> None:
    home.file.write_text(EXPECTING)
    done = home.run("launch", home.file)
    assert done.returncode == 2
    assert "say where it can: --listen" in done.stderr
    assert home.run("launch", home.file, "--check").returncode == 0
    assert "joined: true" in home.run("launch", home.file, "--print").stdout
    home.file.write_text(EXPECTING.replace("clock: wall", "clock: sim"))
    assert "that takes clock: wall" in home.run("launch", home.file, "--check").stderr


def test_the_launch_file_may_say_where_to_listen(home: Host, away: Host) -> None:
    home.file.write_text(home.file.read_text() + "listen: tcp://127.0.0.1:0\n")
    book = home.book("keeper")
    graph = Launched(home, home.start("launch", home.file, f"notes:={book.path}"), book)
    away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "guest"))
    graph.said("/guest has joined")


def test_the_work_of_a_joined_node_may_end_the_run(home: Host, away: Host) -> None:
    home.file.write_text(EXPECTING.replace("joined: true", "joined: true, on_exit: shutdown"))
    graph = home.launch()
    away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "metronome", "-p", "count:=30"))
    assert graph.process.wait(PATIENCE_S) == 0
    assert away.all_gone()
