"""The other end of a connection between hosts: what it may be sent, what it has sent, whether it lives."""

import logging
from collections.abc import Callable

import msgspec

from palp_core.counted import counted
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.network import join_protocol
from palp_core.graph.network.curve_listener import Sent
from palp_core.graph.process.health import PULSE_NS

_LOG = logging.getLogger("palp.gateway")


class Peer:
    """One connection.

    Args:
        transmit: Sends a message without waiting.
        key: Its public key; "" without CURVE.
        address: Where it is.

    Attributes:
        request: How it has joined; None before.
        topics: What it listens to.
        gone: It cannot be reached any more.
        dropped_count: Frames that were not sent because too much was on its way to it.
        rejected_count: Messages of its that were none of this protocol's, or not its to send.
    """

    def __init__(self, transmit: Callable[[list[bytes]], Sent], key: str = "", address: str = "") -> None:
        self._transmit = transmit
        self.key, self.address = key, address
        self.request: join_protocol.JoinRequest | None = None
        self.topics: set[bytes] = set()
        self.gone = False
        self.dropped_count = 0
        self.rejected_count = 0
        self._sent_bytes = 0
        self._taken_bytes = 0
        self._received_bytes = 0
        self._told_bytes = 0
        self._heard_ns = monotonic_ns()
        self._pulse_ns = 0

    def send(self, message: join_protocol.JoinMessage) -> None:
        """Send a message; a peer that takes no more of them is as good as gone."""
        if self._transmit(join_protocol.encode_message(message)) is not Sent.QUEUED:
            self.gone = True

    def reply(self, reply: join_protocol.Reply) -> None:
        """Answer a request; a large reply to one who takes none is replaced by a word that says so."""
        outcome = self._transmit(join_protocol.encode_message(reply))
        if outcome is Sent.FULL:
            text = "too many large replies wait to be taken; take them and ask again"
            refused = join_protocol.Reply(ticket=reply.ticket, body=msgspec.msgpack.encode({"error": text}))
            outcome = self._transmit(join_protocol.encode_message(refused))
        self.gone = self.gone or outcome is not Sent.QUEUED

    def forward(self, parts: list[bytes]) -> None:
        """Send a frame unless too much is under way; its reader sees the gap and asks for what is missing."""
        if self._sent_bytes - self._taken_bytes > join_protocol.WINDOW_BYTES:
            self._drop()
            return
        outcome = self._transmit(parts)
        if outcome is Sent.QUEUED:
            self._sent_bytes += sum(map(len, parts))
        elif outcome is Sent.FULL:
            self._drop()
        else:
            self.gone = True

    def _drop(self) -> None:
        self.dropped_count += 1
        if self.dropped_count & (self.dropped_count - 1) == 0:  # the 1st, 2nd, 4th, 8th ...
            _LOG.warning(
                "dropped %s on the way to %s: it is too slow", counted(self.dropped_count, "frame"), self
            )

    def reject(self, why: str) -> None:
        """Count a message that cannot be accepted."""
        self.rejected_count += 1
        if self.rejected_count & (self.rejected_count - 1) == 0:
            _LOG.warning(
                "rejected %s of %s; the latest: %s", counted(self.rejected_count, "message"), self, why
            )

    def note_alive(self) -> None:
        """Note that it has just been heard."""
        self._heard_ns = monotonic_ns()

    def received(self, parts: list[bytes]) -> None:
        """Account for a frame of its."""
        self._received_bytes += sum(map(len, parts))
        if self._received_bytes - self._told_bytes > join_protocol.WINDOW_BYTES // 4:
            self.beat()

    def beat(self) -> None:
        """Say that this end lives and what it has received."""
        self._told_bytes = self._received_bytes
        self.send(join_protocol.Beat(received_bytes=self._received_bytes))

    def on_beat(self, beat: join_protocol.Beat) -> None:
        """Note how much it has received, as it says."""
        self._taken_bytes = max(self._taken_bytes, min(beat.received_bytes, self._sent_bytes))

    def health_is_due(self, now_ns: int) -> bool:
        """Tell whether it is time for another report of how it does."""
        due = now_ns >= self._pulse_ns
        self._pulse_ns = now_ns + PULSE_NS // 2 if due else self._pulse_ns
        return due

    @property
    def silent(self) -> bool:
        """True when it has not been heard for so long that it counts as dead."""
        return monotonic_ns() - self._heard_ns > join_protocol.SILENCE_NS

    def __str__(self) -> str:
        name = f"/{self.request.name} on {self.request.host}" if self.request else "a host"
        return f"{name} ({self.address})" if self.address else name
