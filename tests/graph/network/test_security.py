"""Who has no business in a graph gets nothing, and is told so on both sides."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.network.join_protocol import PROTOCOL
from palp_core.graph.network.keys import KeyFolder, OwnKeys
from tests.support.hosts import Host, Launched, joining, own_host, trusting
from tests.support.palp import finished

PATIENCE_NS = 60_000_000_000


@pytest.fixture
def home() -> Iterator[Host]:
    with own_host() as host:
        yield host


@pytest.fixture
def away() -> Iterator[Host]:
    with own_host() as host:
        yield host


class Raw:
    """A client of nothing but pyzmq and msgpack."""

    def __init__(self, address: str, server_key: str = "", own: OwnKeys | None = None) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.DEALER)
        self.socket.setsockopt(zmq.LINGER, 0)
        if own is not None:
            self.socket.curve_serverkey = server_key.encode()
            self.socket.curve_publickey = own.public.encode()
            self.socket.curve_secretkey = own.secret.encode()
        self.socket.connect(address)

    def say(self, op: str, **fields: Any) -> None:
        self.socket.send(msgpack.packb({"op": op, **fields}))

    def until(self, op: str) -> dict[str, Any]:
        """Wait for a word; frames and other words are passed over."""
        end_ns = monotonic_ns() + PATIENCE_NS
        while True:
            while not self.socket.poll(500):
                assert monotonic_ns() < end_ns, f"no {op}"
                self.say("beat", received_bytes=0)  # who says nothing for 3 s counts as dead
            parts = self.socket.recv_multipart()
            if parts[0][:1] != b"/" and (word := msgpack.unpackb(parts[0]))["op"] == op:
                return dict(word)

    def close(self) -> None:
        self.context.destroy(linger=0)


@pytest.fixture
def guest(home: Host, away: Host) -> Iterator[tuple[Launched, Raw]]:
    """A graph, and a host that it trusts, with a client that does as it likes."""
    trusting(home, away)
    graph = home.launch()
    own, server = away.keys.own(), home.keys.own()
    assert own is not None
    assert server is not None
    raw = Raw(graph.address, server.public, own)
    yield graph, raw
    raw.close()


def refusals(graph: Launched) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = graph.ask("gateway", op="refusals")["refusals"]
    return found


def test_a_stranger_without_a_key_is_refused_and_both_sides_say_so(home: Host, away: Host) -> None:
    home.keys.generate("home")
    graph = home.launch()
    done = away.run("run", "nodes.toys:Ticker", "--name", "guest", "--join", graph.address)
    assert done.returncode == 2
    assert "a caller without a key: make one (palp keys generate)" in done.stderr
    graph.said("refused a stranger")
    (entry,) = refusals(graph)
    assert (entry["count"], entry["address"]) == (1, "127.0.0.1")
    assert "no key" in entry["reason"]


def test_a_stranger_with_a_wrong_server_key_is_refused_and_both_sides_say_so(home: Host, away: Host) -> None:
    home.keys.generate("home")
    home.keys.allow(away.keys.generate("away").public, "away")
    graph = home.launch()
    wrong = KeyFolder(away.folder / "other").generate("other").public
    done = away.run("run", "nodes.toys:Ticker", "--join", graph.address, "--server-key", wrong)
    assert done.returncode == 2
    assert "--server-key is not its public key" in done.stderr
    assert "wrong server key" in graph.said("refused a stranger")
    assert "wrong server key" in refusals(graph)[0]["reason"]


def test_a_stranger_that_knows_the_server_key_only_is_refused_by_name(home: Host, away: Host) -> None:
    home.keys.generate("home")
    stranger = away.keys.generate("away").public
    graph = home.launch()
    done = away.run(*joining(home, graph, "nodes.toys:Ticker"))
    assert done.returncode == 2
    assert f"palp keys allow '{stranger}'" in done.stderr
    assert stranger in graph.said("refused a stranger")
    (entry,) = refusals(graph)
    assert entry["key"] == stranger
    assert entry["address"] == "127.0.0.1"
    command = re.search(r"palp keys allow '(.*)' --name NAME", entry["reason"])
    assert command is not None
    allowed = home.run("keys", "allow", command[1], "--name", "away")
    assert allowed.returncode == 0, allowed.stderr
    process = away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "guest"))
    graph.said("/guest has joined")
    assert process.poll() is None


def test_a_key_that_is_denied_is_cut_off_from_the_running_graph(home: Host, away: Host) -> None:
    trusting(home, away)
    graph = home.launch()
    process = away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "guest"))
    graph.said("/guest has joined")
    assert home.run("keys", "deny", "away").returncode == 0
    status, said = finished(process)
    assert status == 1
    assert "no longer allowed" in said
    graph.said("/guest has left")


def test_strangers_get_nothing_whatever_they_send(home: Host, away: Host) -> None:
    home.keys.generate("home")
    graph = home.launch()
    port = int(graph.address.rpartition(":")[2])
    for garbage in (b"GET / HTTP/1.0\r\n\r\n", b"\xff" * 200, b"\xff" + bytes(8) + b"\x7f\x03" + b"x" * 53):
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.sendall(garbage)
            connection.settimeout(30.0)
            received = b""
            try:
                while data := connection.recv(4096):
                    received += data
            except ConnectionError:
                pass
            assert len(received) <= 64  # the greeting that every ZeroMQ socket sends
    plain = Raw(graph.address)
    plain.say("hello", protocol=PROTOCOL)
    for _ in range(3):
        graph.said("refused a stranger")
    assert not plain.socket.poll(0)
    plain.close()
    assert graph.ask("gateway", op="refusals")["count"] >= 3
    assert graph.ask("ticker", op="info")["lifecycle"] == "active"


@pytest.mark.parametrize("address", ["tcp://0.0.0.0:0", "tcp://*:0", "tcp://[::]:0"])
def test_nobody_listens_beyond_loopback_without_keys(home: Host, address: str) -> None:
    book = home.book()
    done = home.run("launch", home.file, f"notes:={book.path}", "--listen", address)
    assert done.returncode == 2
    assert "refusing to listen" in done.stderr
    assert "palp keys generate" in done.stderr
    assert home.all_gone()
    assert not list(home.runtime_dir.glob("palp/*"))


def test_an_address_that_is_taken_is_said_before_any_node_starts(home: Host) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = home.run("launch", home.file, "--listen", f"tcp://127.0.0.1:{taken.getsockname()[1]}")
    assert done.returncode == 2
    assert "Address already in use" in done.stderr
    assert not list(home.runtime_dir.glob("palp/*"))


def test_on_loopback_without_keys_there_is_a_warning_and_joining_needs_none(home: Host, away: Host) -> None:
    graph = home.launch()
    graph.said("without keys: every user of this host can join")
    away.start("run", "nodes.toys:Ticker", "--name", "guest", "--join", graph.address)
    graph.said("/guest has joined")


def test_a_caller_with_a_key_is_told_that_the_graph_has_none(home: Host, away: Host) -> None:
    graph = home.launch()
    own = away.keys.generate("away")
    done = away.run("run", "nodes.toys:Ticker", "--join", graph.address, "--server-key", own.public)
    assert done.returncode == 2
    assert "leave out --server-key" in done.stderr


@pytest.mark.nightly
def test_a_call_that_is_not_answered_ends_with_a_hint(away: Host) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        address = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        done = away.run("run", "nodes.toys:Ticker", "--join", address)
        assert done.returncode == 2
        assert "says nothing" in done.stderr


def test_a_secret_that_others_can_read_is_refused_with_the_command_that_mends_it(home: Host) -> None:
    home.keys.generate("home")
    secret = home.keys.path / "home.secret"
    secret.chmod(0o644)
    done = home.run("launch", home.file, "--listen", "tcp://127.0.0.1:0")
    assert done.returncode == 2
    assert f"chmod 600 {secret}" in done.stderr


def test_the_secret_is_seen_nowhere(home: Host, away: Host) -> None:
    trusting(home, away)
    graph = home.launch()
    away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "guest"))
    graph.said("/guest has joined")
    listed = [home.run("keys", "list").stdout, home.run("keys", "list", "--json").stdout]
    commands = [" ".join(process.cmdline()) for host in (home, away) for process in host.running("palp_core")]
    for host in (home, away):
        host.close()  # so that no file comes or goes while they are read
    logs = [
        file.read_text(errors="replace")
        for host in (home, away)
        for file in host.runtime_dir.rglob("*")
        if file.is_file() and "keys" not in file.parts
    ]
    for host in (home, away):
        own = host.keys.own()
        assert own is not None
        assert all(own.secret not in text for text in (*listed, *logs, *commands, repr(own)))


def test_a_guest_speaks_for_itself_only(guest: tuple[Launched, Raw]) -> None:
    graph, raw = guest
    raw.say("hello", protocol=PROTOCOL)
    view = raw.until("graph")["view"]
    assert "/ticker/tick" in view["topics"]
    request = {"name": "guest", "run": "x:Y", "host": "away", "pid": 1}
    raw.say("join", request={**request, "outputs": {"/ticker/tick": view["topics"]["/ticker/tick"]}})
    assert "under its own name only" in raw.until("refused")["text"]
    raw.say("join", request=request)
    assert raw.until("joined")["epoch"] == 1
    for topic, kind in (
        (b"/ticker/tick", Kind.DATA),
        (b"/guest/x", Kind.MOVED),
        (b"/graph/events", Kind.DATA),
    ):
        raw.socket.send(pack(topic, kind, 9, 9, 9, 9, b"ipc:///tmp/elsewhere"))
    for words in (b"", b"\x81", b"\x91" * 5000, os.urandom(64), msgpack.packb({"op": "joined", "epoch": 3})):
        raw.socket.send(words)
    raw.socket.send_multipart([b"a", b"b", b"c"])
    raw.say("subscribe", topic="/../../etc/passwd")
    raw.say("clock", sent_ns=5)
    assert raw.until("clock")["sent_ns"] == 5
    (entry,) = graph.ask("gateway", op="guests")["guests"]
    assert entry["rejected"] == 10
    assert graph.ask("ticker", op="info")["lifecycle"] == "active"


def test_a_guest_may_look_at_the_launcher_but_not_stop_the_graph(guest: tuple[Launched, Raw]) -> None:
    graph, raw = guest
    raw.say("hello", protocol=PROTOCOL)
    raw.until("graph")
    for ticket, op in enumerate(("stop", "swap", "graph")):
        raw.say("request", ticket=ticket, node="graph", body=msgpack.packb({"op": op, "node": "graph"}))
    replies = {}
    for _ in range(3):
        reply = raw.until("reply")
        replies[reply["ticket"]] = msgpack.unpackb(reply["body"])
    assert "another may only look" in replies[0]["error"]
    assert "another may only look" in replies[1]["error"]
    assert replies[2]["graph"] == "home"
    assert graph.process.poll() is None


@pytest.mark.parametrize("version", [1, 99])
def test_another_version_is_told_apart(guest: tuple[Launched, Raw], version: int) -> None:
    _, raw = guest
    raw.say("hello", protocol=version)
    assert f"version {PROTOCOL} of joining, not {version}" in raw.until("refused")["text"]


def test_a_key_is_allowed_listed_and_denied_by_command(home: Host, tmp_path: Path) -> None:
    other = KeyFolder(tmp_path / "other").generate("laptop")
    made = home.run("keys", "generate", "--name", "rig")
    assert made.returncode == 0, made.stderr
    assert Path(made.stdout.strip()) == home.keys.path / "rig.public"
    assert home.run("keys", "generate").returncode == 2
    assert home.run("keys", "allow", tmp_path / "other/laptop.public").returncode == 0
    assert other.public in home.run("keys", "list").stdout
    assert home.run("keys", "allow", "nonsense").returncode == 2
    assert home.run("keys", "deny", "laptop").returncode == 0
    assert other.public not in home.run("keys", "list").stdout
