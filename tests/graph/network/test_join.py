"""Nodes of another host in a running graph: they read, publish and end as any other."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
from collections.abc import Iterator
from typing import Any

import psutil
import pytest

from palp_core.graph.network.join_protocol import PROTOCOL
from tests.support.hosts import LAUNCH, Host, Launched, NoteBook, Raw, joining, keeping, own_host, trusting
from tests.support.palp import PATIENCE_S, end, finished


@pytest.fixture(scope="module")
def home() -> Iterator[Host]:
    """The host of a graph that every guest leaves as it was."""
    with own_host() as host:
        host.keys.generate("home")
        yield host


EXPECTED = """
  pulse: {{run: "nodes.toys:Ticker", params: {{rate_hz: 50.0}}, joined: true}}
  scribe: {{run: "nodes.toys:Keeper", params: {{notes: {}}}, inputs: {{tick: pulse/tick}}}}
"""


@pytest.fixture(scope="module")
def pulses(home: Host) -> NoteBook:
    """What a node at home writes down of one that the launch file expects."""
    book = home.book("pulses")
    home.file.write_text(LAUNCH + EXPECTED.format(book.path))
    return book


@pytest.fixture(scope="module")
def graph(home: Host, pulses: NoteBook) -> Launched:
    return home.launch()


@pytest.fixture
def away(home: Host, graph: Launched) -> Iterator[Host]:
    """A host that the graph lets in, whose guests have left when the next one comes."""
    with own_host() as host:
        home.keys.allow(host.keys.generate("away").public, host.folder.name)
        yield host
    graph.until(lambda: not graph.guests)


@pytest.fixture
def lone_home() -> Iterator[Host]:
    """The host of a graph of one's own."""
    with own_host() as host:
        yield host


@pytest.fixture
def lone_away(lone_home: Host) -> Iterator[Host]:
    with own_host() as host:
        trusting(lone_home, host)
        yield host


def node_process(host: Host, parent: str) -> psutil.Process:
    """The process of the node itself: a child of the fork server."""
    (found,) = (child for process in host.running(parent) for child in process.children())
    return found


def test_a_node_of_another_host_reads_all_on_the_graphs_clock_and_tools_use_it_as_any_other_until_ctrl_c(
    home: Host, graph: Launched, away: Host
) -> None:
    book, guest = keeping(home, graph, away, "guest")
    graph.until_printed("/guest has joined")
    ticks = [book.until("tick") for _ in range(100)]
    indices = [int(tick[1]) for tick in ticks]
    assert indices == list(range(indices[0], indices[0] + 100))
    delays_s = [(int(now_ns) - int(sent_ns)) / 1e9 for _, _, sent_ns, now_ns in ticks]

    graph.until(lambda: "guest" in graph.nodes)
    assert graph.record["listen"] == graph.address
    assert '"index"' in home.printed("topic", "echo", "/guest/received", "--once", "--json")
    info = graph.ask("guest", op="info")
    assert (info["name"], info["inputs"]["/ticker/tick"]["lost"]) == ("guest", 0)
    assert graph.ask("guest", op="no_such")["error"]
    does: dict[str, Any] = {}
    while does.get("lifecycle") != "active":
        echoed = home.run("topic", "echo", "/graph/health", "--json", "--once")
        does = next((node for node in json.loads(echoed.stdout)["nodes"] if node["node"] == "guest"), {})
    assert does["pid"] == 0
    assert does["memory_bytes"] > 0
    assert [edge["topic"] for edge in does["edges"]] == ["/ticker/tick"]
    assert json.loads(graph.wait_for("joined", "guest").data)["address"] == "127.0.0.1"

    guest.send_signal(signal.SIGINT)
    status, said = finished(guest)
    known = re.search(r"its clock is known to ([\d.]+) ms", said)
    assert known is not None
    assert min(delays_s) >= -(float(known[1]) + 0.001) / 1e3, "its clock is not the graph's"
    assert status == 130
    assert "the node exited" in said
    book.until("safe")
    graph.until_printed("/guest has left")
    assert away.all_gone()


def test_two_guests_hear_each_other_and_large_messages_cross_whole(
    home: Host, graph: Launched, away: Host
) -> None:
    large = ("-p", "size:=300000", "-p", "rate_hz:=20.0")
    away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "drummer", *large))
    graph.until_printed("/drummer has joined")
    book, _ = keeping(home, graph, away, "second", "/drummer/tick")
    indices = [int(book.until("tick")[1]) for _ in range(20)]
    assert indices == list(range(indices[0], indices[0] + 20))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nodes.toys:Keeper", "--name", "ticker", "-r", "tick:=/ticker/tick"), "'ticker' is in graph"),
        (("nodes.toys:Ticker", "-p", "rate:=5.0"), "did you mean 'rate_hz'"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_reason(
    home: Host, graph: Launched, away: Host, arguments: tuple[str, ...], words: str
) -> None:
    """By the gateway, and before it is asked; ``test_join_rules.py`` has the other reasons."""
    assert words in away.refused(*joining(home, graph, *arguments))
    assert away.all_gone()
    assert graph.launcher.poll() is None


def test_a_guest_that_is_killed_leaves_and_the_next_of_its_name_is_another_to_its_reader(
    home: Host, pulses: NoteBook, graph: Launched, away: Host
) -> None:
    pulse = joining(home, graph, "nodes.toys:Ticker", "--name", "pulse")
    guest = away.start(*pulse)
    indices = [int(pulses.until("tick")[1]) for _ in range(20)]
    assert indices == list(range(1, 21))
    node_process(away, "fork_server").kill()
    status, said = finished(guest)
    assert status == 1
    assert "SIGKILL" in said
    graph.until_printed("/pulse has left")
    assert "has not joined" in graph.ask("pulse", op="info")["error"]
    again = away.start(*pulse)
    while int(pulses.until("tick")[1]) != 1:  # each turn waits at the pipe
        pass
    accounts = graph.ask("scribe", op="info")["inputs"]["/pulse/tick"]
    assert (accounts["lost"], accounts["epoch"]) == (0, 2)
    os.kill(again.pid, signal.SIGKILL)
    graph.until_printed("/pulse has left")
    assert away.all_gone()
    graph.until(lambda: not graph.guests)


def test_when_the_gateway_dies_the_guest_is_safe_the_graph_goes_on_and_can_be_joined_again(
    home: Host, graph: Launched, away: Host
) -> None:
    book, guest = keeping(home, graph, away, "bereft")
    book.until("tick")
    graph.gateway().kill()
    status, said = finished(guest)
    assert status == 1
    assert "has ended" in said
    book.until("safe")
    graph.until_printed("the gateway listens again")
    assert graph.ask("ticker", op="info")["lifecycle"] == "active"
    own, server = away.keys.own(), home.keys.own()
    assert own is not None
    assert server is not None
    with contextlib.closing(Raw(graph.address, server.public, own)) as again:
        again.say("hello", protocol=PROTOCOL)
        again.until("graph")
        again.say("join", request={"name": "bereft", "run": "x:Y", "host": "away", "pid": 1})
        assert again.until("joined")["epoch"] == 2


def lasting(home: Host, seconds: int) -> None:
    """Wait for as many ticks as the graph makes in that time."""
    assert home.run("topic", "echo", "/ticker/tick", "--times", str(100 * seconds)).returncode == 0


def end_of_join(graph: Launched, away: Host, end: str) -> psutil.Process:
    if end == "gateway":
        return graph.gateway()
    return away.running("--join")[0] if end == "run" else node_process(away, "fork_server")


@pytest.mark.parametrize("part", ["node", "run", "gateway"])
def test_an_end_of_a_join_that_stops_for_a_second_loses_nothing(
    home: Host, graph: Launched, away: Host, part: str
) -> None:
    book, guest = keeping(home, graph, away, "nodding")
    first = int(book.until("tick")[1])
    stopped = end_of_join(graph, away, part)
    stopped.suspend()
    lasting(home, 1)
    stopped.resume()
    assert [int(book.until("tick")[1]) for _ in range(200)] == list(range(first + 1, first + 201))
    end(guest)
    graph.until_printed("/nodding has left")


@pytest.mark.parametrize("seconds", [4, pytest.param(30, marks=pytest.mark.nightly)])
def test_both_ends_of_a_join_know_of_a_node_that_is_silent_and_it_goes_on(
    home: Host, graph: Launched, away: Host, seconds: int
) -> None:
    book, guest = keeping(home, graph, away, "asleep")
    first = int(book.until("tick")[1])
    stopped = end_of_join(graph, away, "node")
    stopped.suspend()
    lasting(home, seconds)
    graph.until_printed("/asleep has sent no heartbeat for 3 s")
    stopped.resume()
    graph.until_printed("/asleep: answers again")
    count = 100 * seconds
    assert [int(book.until("tick")[1]) for _ in range(count)] == list(range(first + 1, first + 1 + count))
    guest.send_signal(signal.SIGINT)
    status, said = finished(guest)
    assert status == 130
    assert "asleep has sent no heartbeat for 3 s" in said


@pytest.mark.parametrize(
    ("end", "seconds"),
    [
        ("run", 0),
        *(
            pytest.param(end, seconds, marks=pytest.mark.nightly)
            for end in ("run", "host", "gateway")
            for seconds in (4, 30)
        ),
    ],
)
def test_both_ends_of_a_join_know_of_one_that_slept_and_the_guest_is_safe(
    home: Host, graph: Launched, away: Host, end: str, seconds: int
) -> None:
    book, guest = keeping(home, graph, away, "sleeper")
    book.until("tick")
    slept = [end_of_join(graph, away, "run" if end == "host" else end)]
    slept += slept[0].children(recursive=True) if end == "host" else []
    for process in slept:
        process.suspend()
    if seconds:
        lasting(home, seconds)
    else:
        graph.until_printed("has left: nothing came from it for 3 s")
    for process in slept:
        process.resume()
    status, said = finished(guest)
    assert status == 1
    assert "this graph has dropped the connection" in said or "answers no longer" in said  # who is first
    book.until("safe")
    if seconds:
        graph.until_printed("/sleeper has left")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_when_the_graph_ends_nothing_remains_and_its_guest_is_safe(
    lone_home: Host, lone_away: Host, number: signal.Signals
) -> None:
    lone_home.file.write_text(lone_home.file.read_text() + "listen: tcp://127.0.0.1:0\n")
    graph = lone_home.launch(listen="")  # the launch file says where
    book, guest = keeping(lone_home, graph, lone_away, "guest")
    book.until("tick")
    graph.launcher.send_signal(number)
    assert graph.launcher.wait(PATIENCE_S) == (-number if number == signal.SIGKILL else 128 + number)
    assert finished(guest)[0] == 1
    book.until("safe")
    assert lone_home.all_gone()
    assert lone_away.all_gone()


def test_a_node_runs_alone_and_takes_messages_from_outside(lone_home: Host) -> None:
    book = lone_home.book()
    alone = lone_home.start("run", "nodes.toys:Keeper", "-p", f"notes:={book.path}")
    book.until("active")
    graph = Launched.__new__(Launched)
    graph.palp = lone_home
    assert graph.ask("keeper", op="publish", port="tick", message={"index": 7})["sequence"] == 1
    assert book.until("tick")[1] == "7"
    (entry,) = graph.record["nodes"]
    assert psutil.pid_exists(entry["pid"])
    assert "/keeper/tick" in lone_home.run("topic", "list").stdout
    end(alone)
    book.until("safe")
    assert lone_home.all_gone()


EXPECTING = """
graph: home
clock: wall
args:
  notes: {default: "", help: of the keeper}
nodes:
  metronome: {run: "nodes.toys:Ticker", params: {rate_hz: 50.0}, joined: true, on_exit: shutdown}
  keeper:
    run: nodes.toys:Keeper
    params: {notes: $(var notes)}
    inputs: {tick: metronome/tick}
"""


def test_a_node_that_the_launch_file_expects_joins_with_its_wires_and_params_and_its_work_may_end_the_run(
    lone_home: Host,
) -> None:
    """On loopback, where keys are not needed."""
    lone_home.file.write_text(EXPECTING)
    graph = lone_home.launch()  # it does not wait
    graph.until_printed("without keys: every user of this host can join")
    assert "palp run nodes.toys:Ticker --name metronome --join" in graph.until_printed("/metronome can join")
    with own_host() as away:
        away.start("run", "nodes.toys:Ticker", "--name", "metronome", "--join", graph.address)
        indices = [int(graph.book.until("tick")[1]) for _ in range(20)]
        assert indices == list(range(1, 21))
        assert graph.ask("metronome", op="info")["params"]["rate_hz"] == 50.0
        graph.ask("metronome", op="set_parameters", parameters={"count": 1})
        graph.ask("metronome", op="call", service="reset", request={"index": 0})
        assert graph.launcher.wait(PATIENCE_S) == 0
        assert away.all_gone()


@pytest.mark.parametrize(
    ("text", "listen", "words"),
    [
        (
            LAUNCH.replace("clock: wall", "clock: sim"),
            ["tcp://127.0.0.1:0"],
            "only one with clock: wall can be",
        ),
        (EXPECTING, [], "metronome joins from another host; add --listen"),
    ],
)
def test_a_graph_that_cannot_be_joined_is_not_launched(
    lone_home: Host, text: str, listen: list[str], words: str
) -> None:
    lone_home.file.write_text(text)
    where = (f"--listen={address}" for address in listen)
    assert words in lone_home.refused("launch", lone_home.file, *where)
