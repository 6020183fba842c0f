"""A listener behind CURVE and those who call it: each side knows why it does not come about."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zmq

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.network import curve
from palp_core.graph.network.curve import CurveCaller, CurveListener, Received, Sent, _peer_of
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.network.join_protocol import JoinRefused
from palp_core.graph.network.keys import KeyFolder, OwnKeys
from palp_core.graph.network.relay import Peer
from palp_core.graph.transport.zmq_sockets import InFlightBytes

PATIENCE_NS = 60_000_000_000


class Ends:
    """A listener, its callers, and what they were told; all in one loop, with a context for each."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.reactors: list[EventLoop] = []
        self.messages: list[Received] = []
        self.refused: list[tuple[str, str, str]] = []
        self.failures: list[str] = []
        self.replies: list[bytes] = []
        self.greetings = 0
        self.disconnected = 0
        self.allowed: set[str] = set()
        self.endpoint = ""

    def keys(self, name: str) -> OwnKeys:
        return KeyFolder(self.folder / name).generate(name)

    def listen(self, own: OwnKeys | None, endpoint: str = "tcp://127.0.0.1:0") -> CurveListener:
        listener = CurveListener(
            self._event_loop(),
            endpoint,
            own,
            admits=lambda key: key in self.allowed,
            receive=self.messages.append,
            refused=lambda *who: self.refused.append(who),
            disconnected=self._count_end,
        )
        self.endpoint = listener.endpoint
        return listener

    def call(self, own: OwnKeys | None, server_key: str = "") -> CurveCaller:
        return CurveCaller(
            self._event_loop(),
            self.endpoint,
            own,
            server_key,
            receive=self.replies.append,
            connected=self._count_greeting,
            failed=self.failures.append,
        )

    def _event_loop(self) -> EventLoop:
        self.reactors.append(EventLoop())
        return self.reactors[-1]

    def _count_greeting(self) -> None:
        self.greetings += 1

    def _count_end(self) -> None:
        self.disconnected += 1

    def until(self, so: Callable[[], object]) -> None:
        end_ns = monotonic_ns() + PATIENCE_NS
        while not so():
            assert monotonic_ns() < end_ns, (self.refused, self.failures)
            for event_loop in self.reactors:
                event_loop.turn(0.005)

    def close(self) -> None:
        for event_loop in self.reactors:
            event_loop.close()


@pytest.fixture
def ends(tmp_path: Path) -> Iterator[Ends]:
    made = Ends(tmp_path)
    yield made
    made.close()


def test_an_allowed_key_is_let_in_known_by_each_message_and_both_ends_notice_the_end(ends: Ends) -> None:
    server, mine = ends.keys("server"), ends.keys("mine")
    ends.allowed.add(mine.public)
    listener = ends.listen(server)
    caller = ends.call(mine, server.public)
    ends.until(lambda: ends.greetings)
    assert caller.send(b"b" * 100_000) is Sent.QUEUED
    ends.until(lambda: ends.messages)
    (message,) = ends.messages
    assert (message.key, message.address, message.message) == (mine.public, "127.0.0.1", b"b" * 100_000)
    in_flight = InFlightBytes(1 << 20)
    assert listener.send(message.connection, in_flight, b"c") is Sent.QUEUED
    ends.until(lambda: ends.replies)
    assert ends.replies == [b"c"]
    assert not ends.refused
    assert not ends.failures
    ends.reactors.pop().close()
    ends.until(lambda: ends.disconnected)
    # The monitor may report it before the socket, which takes what it is given until it knows.
    ends.until(lambda: listener.send(message.connection, in_flight, b"c") is Sent.GONE)
    ends.call(mine, server.public)
    ends.until(lambda: ends.greetings == 2)
    ends.reactors.pop(0).close()
    ends.until(lambda: ends.failures)
    assert "has ended" in ends.failures[0]


@pytest.mark.parametrize("size", [1 << 18, 500])
def test_no_more_than_a_window_waits_for_a_host_that_reads_nothing_and_it_is_no_reason_to_drop_the_host(
    ends: Ends, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    monkeypatch.setattr(curve, "WINDOW_BYTES", 4 << 20)
    listener = ends.listen(None)
    with zmq.Context() as context, context.socket(zmq.DEALER) as slow:
        slow.setsockopt(zmq.RCVHWM, 1)
        slow.setsockopt(zmq.RCVBUF, 1 << 12)
        slow.setsockopt(zmq.LINGER, 0)
        slow.connect(ends.endpoint)
        slow.send(b"a")
        ends.until(lambda: ends.messages)
        connection, in_flight = ends.messages[0].connection, curve.in_flight_bytes()
        peer = Peer(connection, lambda message: listener.send(connection, in_flight, message))
        sent = 0
        while peer.dropped_count < 100:  # the kernel's buffers hold some of them, at any time
            peer.forward(b"/a/b\0" + bytes(size))
            sent += 1
        held = sent - peer.dropped_count
        assert not in_flight.has_room(curve.WINDOW_BYTES + 2 * max(size, curve.LEAST_BYTES))
        peer.send(JoinRefused(text="x" * 100_000))
        assert not peer.gone
        received = 0

        def all_taken() -> bool:
            nonlocal received
            while slow.poll(10):
                slow.recv()
                received += 1
            return received == held + 1

        ends.until(all_taken)
        peer.forward(b"/a/b\0" + bytes(1 << 20))
        assert slow.recv() == b"/a/b\0" + bytes(1 << 20)


@pytest.mark.parametrize(
    ("listens", "calls", "knows", "there", "here"),
    [
        ("server", "mine", "server", "its key is not allowed here", "palp keys allow '{mine}'"),
        ("server", "mine", "mine", "wrong server key", "--server-key is not its public key"),
        ("server", None, "server", "no key", "palp keys generate"),
        (None, "mine", "server", "", "leave out --server-key"),
    ],
)
def test_a_caller_that_is_not_let_in_is_named_there_and_knows_why(
    ends: Ends, listens: str | None, calls: str | None, knows: str, there: str, here: str
) -> None:
    pairs = {name: ends.keys(name) for name in ("server", "mine")}
    ends.listen(pairs[listens] if listens else None)
    ends.call(pairs[calls] if calls else None, pairs[knows].public)
    ends.until(lambda: ends.refused and ends.failures)
    address, key, reason = ends.refused[0]
    assert address == "127.0.0.1"
    assert key == (pairs["mine"].public if "not allowed" in there else "")
    assert there in reason
    assert here.format(mine=pairs["mine"].public) in ends.failures[0]
    assert not ends.greetings


def test_strangers_that_only_connect_are_cut_and_a_host_that_is_let_in_stays(
    ends: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(curve, "MOST_STRANGERS", 5)
    server, mine = ends.keys("server"), ends.keys("mine")
    ends.allowed.add(mine.public)
    ends.listen(server)
    address = ("127.0.0.1", int(ends.endpoint.rpartition(":")[2]))
    with contextlib.ExitStack() as stack:

        def flood() -> None:
            strangers = [stack.enter_context(socket.create_connection(address)) for _ in range(30)]
            ends.until(lambda: len([one for one in strangers if _has_ended(one)]) >= 25)

        flood()
        caller = ends.call(mine, server.public)
        ends.until(lambda: ends.greetings)
        for word in (b"a", b"b", b"c"):
            ends.messages.clear()
            caller.send(word)
            ends.until(lambda: ends.messages)
            flood()
    assert not ends.failures


def _has_ended(stranger: socket.socket) -> bool:
    """Tell whether the other end has hung up, after its greeting."""
    stranger.setblocking(False)
    try:
        while stranger.recv(1024):
            pass
    except BlockingIOError:
        return False
    except ConnectionError:
        pass
    return True


def test_a_message_too_large_ends_its_connection_only(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palp_core.graph.network.curve.LARGEST_BYTES", 10_000)
    ends.listen(None)
    caller, other = ends.call(None), ends.call(None)
    ends.until(lambda: ends.greetings == 2)
    caller.send(bytes(20_000))
    ends.until(lambda: ends.failures)
    other.send(b"a")
    ends.until(lambda: ends.messages)
    assert [message.message for message in ends.messages] == [b"a"]


def test_a_call_that_is_taken_and_not_answered_is_given_up_with_a_hint(
    ends: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(curve, "HANDSHAKE_MS", 200)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        ends.endpoint = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        caller = ends.call(None)
        assert caller.send(b"a") is Sent.GONE  # nothing waits for a connection
        ends.until(lambda: caller.accepted)
        ends.until(lambda: ends.failures)
    assert ends.failures[0].endswith("accepts the call but sends nothing for 0.2 s: it is no palp gateway")


def test_an_address_that_is_taken_or_nonsense_is_an_error(ends: Ends) -> None:
    ends.listen(None)
    with pytest.raises(GraphError, match="in use"):
        ends.listen(None, ends.endpoint)
    ends.endpoint = "tcp://nonsense"
    with pytest.raises(GraphError, match="write tcp://HOST:PORT"):
        ends.call(None)


def test_a_descriptor_that_is_another_files_by_now_has_no_address() -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    one, other = socket.socketpair()
    with one, other, Path(__file__).open() as file:
        assert [_peer_of(descriptor) for descriptor in (one.fileno(), file.fileno(), 9_999)] == [("", 0)] * 3
    assert len(list(Path("/proc/self/fd").iterdir())) <= before  # what others have left may be closed
