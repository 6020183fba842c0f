"""Who has no business in a graph gets nothing, and is told so on both sides."""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import msgpack
import pytest
import zmq

from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.network.join_protocol import LONGEST_TEXT, PROTOCOL
from palp_core.graph.network.keys import KeyFolder
from tests.support.hosts import Host, Launched, Raw, joining, own_host
from tests.support.palp import PATIENCE_S, finished


@pytest.fixture(scope="module")
def home() -> Iterator[Host]:
    """The host of a graph with keys, which everybody leaves as it was."""
    with own_host() as host:
        host.keys.generate("home")
        yield host


@pytest.fixture(scope="module")
def graph(home: Host) -> Launched:
    return home.launch()


@pytest.fixture
def away(graph: Launched) -> Iterator[Host]:
    """A host that the graph does not know; its guests have left when the next one comes."""
    with own_host() as host:
        yield host
    graph.until(lambda: not graph.guests)


@pytest.fixture
def lone_host() -> Iterator[Host]:
    """A host where nothing runs."""
    with own_host() as host:
        yield host


@pytest.fixture
def raw(home: Host, graph: Launched, away: Host) -> Iterator[Raw]:
    """A client of a host that the graph lets in, which does as it likes."""
    own, server = away.keys.generate("away"), home.keys.own()
    assert server is not None
    home.keys.allow(own.public, away.folder.name)
    client = Raw(graph.address, server.public, own)
    yield client
    client.close()


def test_a_stranger_that_knows_the_server_key_is_refused_by_name_let_in_once_allowed_cut_off_when_denied(
    home: Host, graph: Launched, away: Host
) -> None:
    stranger = away.keys.generate("away").public
    join = joining(home, graph, "nodes.toys:Ticker", "--name", "guest")
    assert f"palp keys allow '{stranger}'" in away.refused(*join)
    assert "refused a stranger" in graph.until_printed(stranger)
    (refused,) = [event for event in graph.events() if event.kind == "refused" and stranger in event.text]
    given = json.loads(refused.data)
    assert (given["address"], given["key"]) == ("127.0.0.1", stranger)
    assert "refused a stranger from 127.0.0.1" in home.here("doctor").stdout
    command = re.search(r"palp keys allow '(.*)' --name NAME", refused.text)
    assert command is not None
    allowed = home.here("keys", "allow", command[1], "--name", "away")
    assert allowed.returncode == 0, allowed.stderr
    process = away.start(*join)
    graph.until_printed("/guest has joined")
    assert process.poll() is None
    assert home.here("keys", "deny", "away").returncode == 0
    status, said = finished(process)
    assert status == 1
    assert "no longer allowed" in said
    graph.until_printed("/guest has left")


def test_strangers_get_nothing_whatever_they_send(graph: Launched, away: Host) -> None:
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
    cut_off = plain.socket.get_monitor_socket(zmq.EVENT_DISCONNECTED | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL)
    plain.say("hello", protocol=PROTOCOL)
    assert cut_off.poll(round(PATIENCE_S * 1e3))
    assert not plain.socket.poll(0)
    plain.close()
    assert graph.ask("ticker", op="info")["lifecycle"] == "active"


def test_an_address_that_is_taken_is_said_before_any_node_starts(lone_host: Host) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        done = lone_host.here("launch", lone_host.file, "--listen", address)
    assert done.returncode == 2
    assert "Address already in use" in done.stderr
    assert not list(lone_host.runtime_dir.glob("palp/*"))


def test_the_secret_is_seen_nowhere(home: Host, graph: Launched, away: Host) -> None:
    home.keys.allow(away.keys.generate("away").public, away.folder.name)
    away.start(*joining(home, graph, "nodes.toys:Ticker", "--name", "discreet"))
    graph.until_printed("/discreet has joined")
    seen = [home.here("keys", "list").stdout, home.here("keys", "list", "--json").stdout]
    for host in (home, away):
        seen += [" ".join(process.cmdline()) for process in host.running("palp_core")]
        for file in host.runtime_dir.rglob("*"):
            with contextlib.suppress(FileNotFoundError):  # the graph runs: a file may come and go
                if file.is_file() and "keys" not in file.parts:
                    seen.append(file.read_text(errors="replace"))
    for host in (home, away):
        own = host.keys.own()
        assert own is not None
        assert all(own.secret not in text for text in (*seen, repr(own)))


def test_a_guest_speaks_for_itself_only(graph: Launched, raw: Raw) -> None:
    raw.say("hello", protocol=PROTOCOL)
    assert "/ticker/tick" in raw.until("graph")["view"]["topics"]
    raw.say("join", request={"name": "raw", "run": "x:Y", "host": "away", "pid": 1})
    assert raw.until("joined")["epoch"] == 1
    for topic, kind in ((b"/ticker/tick", Kind.DATA), (b"/raw/x", Kind.MOVED), (b"/graph/events", Kind.DATA)):
        raw.socket.send(pack(topic, kind, 9, 9, 9, 9, b"ipc:///tmp/elsewhere"))
    for words in (b"", b"\x81", b"\x91" * 5000, os.urandom(64), msgpack.packb({"op": "joined", "epoch": 3})):
        raw.socket.send(words)
    raw.socket.send_multipart([b"a", b"b", b"c"])
    raw.say("subscribe", topic="/../../etc/passwd")
    raw.say("clock", sent_ns=5)
    assert raw.until("clock")["sent_ns"] == 5
    assert "rejected 8 messages of " in (graph.folder / "log" / "gateway.log").read_text()
    assert graph.ask("ticker", op="info")["lifecycle"] == "active"
    raw.say("leave", text="x" * 1_000_000, exit_code=-1)
    assert len(graph.until_printed("/raw has left")) < 2 * LONGEST_TEXT


def test_a_key_is_allowed_listed_and_denied_by_command(lone_host: Host, tmp_path: Path) -> None:
    other = KeyFolder(tmp_path / "other").generate("laptop")
    made = lone_host.here("keys", "generate", "--name", "rig")
    assert made.returncode == 0, made.stderr
    assert Path(made.stdout.strip()) == lone_host.keys.path / "rig.public"
    assert lone_host.here("keys", "generate").returncode == 2
    assert lone_host.here("keys", "allow", tmp_path / "other/laptop.public").returncode == 0
    assert other.public in lone_host.here("keys", "list").stdout
    assert lone_host.here("keys", "allow", "nonsense").returncode == 2
    assert lone_host.here("keys", "deny", "laptop").returncode == 0
    assert other.public not in lone_host.here("keys", "list").stdout
