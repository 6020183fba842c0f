"""Who gets past the door of ``palp bridge foxglove``: who has the token and names this host."""

from __future__ import annotations

import ipaddress
import socket
import threading
from collections.abc import Iterator

import pytest

from palp_core.errors import GraphError
from palp_core.graph.foxglove.gate import HEAD_BYTES, Gate, hidden_address
from tests.support.palp import PATIENCE_S

ALLOWED = (
    "https://app.foxglove.dev",
    "file://",
    "http://localhost:8080",
    "https://Lichtblick.example",
)
"""Foxglove's page, a program's, one of this host, and one that the gate was told of."""


@pytest.fixture(scope="module")
def gate() -> Iterator[Gate]:
    """A gate before a server that says hello, and then what it is told."""
    with socket.create_server((hidden_address(), 0)) as server:

        def serve() -> None:
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                with connection:
                    head = connection.recv(HEAD_BYTES)
                    connection.sendall(b"hello " + head.split()[0] + b"\n")
                    while data := connection.recv(HEAD_BYTES):
                        connection.sendall(data)

        threading.Thread(target=serve, daemon=True).start()
        gate = Gate("127.0.0.1", 0, server.getsockname(), ["https://lichtblick.example/"])
        yield gate
        gate.close()
        server.shutdown(socket.SHUT_RDWR)


def port_and_token(gate: Gate) -> tuple[int, str]:
    rest, _, token = gate.address.partition("/?token=")
    return int(rest.rpartition(":")[2]), token


def answer(gate: Gate, head: str, then: bytes = b"") -> str:
    """Return what comes for a request, until there is as much as was sent after it or the gate closes."""
    with socket.create_connection(("127.0.0.1", port_and_token(gate)[0]), PATIENCE_S) as connection:
        connection.sendall(head.encode("latin-1"))
        said = connection.recv(HEAD_BYTES)
        if said.startswith(b"hello"):
            connection.sendall(then)
            while then not in said:
                said += connection.recv(HEAD_BYTES)
        return said.decode()


def asked_by(origin: str) -> str:
    """What a page's WebSocket asks for."""
    return f"GET /?token=TOKEN HTTP/1.1\r\nHost: localhost\r\nOrigin: {origin}\r\n\r\n"


def test_who_has_the_token_is_passed_on_both_ways(gate: Gate) -> None:
    port, token = port_and_token(gate)
    hosts = (f"127.0.0.1:{port}", f"localhost:{port}", f"[::1]:{port}", "localhost")
    for host, origin in zip(hosts, ALLOWED, strict=True):
        head = f"GET /?token={token} HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n\r\n"
        assert answer(gate, head, b"x" * 5000).endswith("x" * 5000)


@pytest.mark.parametrize(
    ("head", "why"),
    [
        ("GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", "token is missing"),
        ("GET /?token= HTTP/1.1\r\nHost: localhost\r\n\r\n", "token is missing"),
        ("GET /?token=wrong HTTP/1.1\r\nHost: localhost\r\n\r\n", "token is missing or wrong"),
        ("GET /?token=TOKENx HTTP/1.1\r\nHost: localhost\r\n\r\n", "token is missing or wrong"),
        ("GET /?token=wrong&token=TOKEN HTTP/1.1\r\nHost: localhost\r\n\r\n", "token is missing or wrong"),
        ("GET /?token=%c3%a9 HTTP/1.1\r\nHost: localhost\r\n\r\n", "token is missing or wrong"),
        ("GET /?token=TOKEN HTTP/1.1\r\nHost: rebound.example\r\n\r\n", "this is not 'rebound.example'"),
        ("GET /?token=TOKEN HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n", "this is not ''"),
        ("GET /?token=TOKEN HTTP/1.1\r\n\r\n", "this is not ''"),
        ("GET /?token=TOKEN HTTP/1.1\r\nHost: [::1\r\n\r\n", "this is not ''"),
        ("POST /?token=TOKEN HTTP/1.1\r\nHost: localhost\r\n\r\n", "not a WebSocket's request"),
        ("\r\n\r\n", "not a WebSocket's request"),
        (asked_by("https://evil.example"), "the page of 'https://evil.example' is no viewer"),
        (asked_by("https://foxglove.dev.evil.example"), "is no viewer"),
        (asked_by("https://evilfoxglove.dev"), "is no viewer"),
        (asked_by("http://app.foxglove.dev"), "is no viewer"),  # whoever is on the way may have written it
        (asked_by("null"), "the page of 'null' is no viewer that is known; if it is yours: --origin"),
        (asked_by("https://app.foxglove.dev\r\nOrigin: https://evil.example"), "evil.example' is no viewer"),
        ("GET /?token=TOKEN HTTP/1.1\r\nHost: localhost\r\nX: " + "x" * HEAD_BYTES + "\r\n\r\n", "too long"),
    ],
)
def test_everybody_else_is_refused_in_words(gate: Gate, head: str, why: str) -> None:
    said = answer(gate, head.replace("TOKEN", port_and_token(gate)[1]))
    assert said.startswith("HTTP/1.1 403 ")
    assert why in said


def test_each_gate_has_a_token_of_its_own(gate: Gate) -> None:
    other = Gate("127.0.0.1", 0, ("127.0.0.1", 1))
    other.close()
    assert port_and_token(other)[1] != port_and_token(gate)[1]
    assert len(port_and_token(gate)[1]) >= 16


def test_a_port_that_is_taken_is_said(gate: Gate) -> None:
    port = port_and_token(gate)[0]
    with pytest.raises(GraphError, match=rf"cannot listen on 127.0.0.1:{port}: .* choose another --port"):
        Gate("127.0.0.1", port, ("127.0.0.1", 1))


def test_the_server_behind_is_on_loopback_and_nowhere_that_is_tried() -> None:
    found = {hidden_address() for _ in range(50)}
    assert len(found) > 40
    assert all(ipaddress.ip_address(address).is_loopback for address in found)
    assert "127.0.0.1" not in found
