"""What each codec costs here: a message like a block of torque, from a publisher's socket to a reader's.

Both are in this process and never asleep, so this is CPU time and no latency.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.codecs import SIZES, decode_json, decode_plain, encode_json, encode_plain
from palp_core.graph.messages.fragments import cut, decode_pieces
from palp_core.graph.messages.frame import IN_PIECES, Frame, Kind, pack, parse
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.transport.publisher_socket import PublisherSocket
from palp_core.graph.transport.subscriber_socket import ARRAY_QUEUE, SubscriberSocket
from palp_core.methods import find
from palp_core.methods.measured import Measured, begins_after, cpu_s
from palp_core.units import Count, HertzPositive, Nanoseconds, NewtonMetresArray

_TOPIC = "/measure/block"
_SLICE_NS, _WAIT_MS, _PATIENCE_NS = 1_000_000, 100, 10_000_000_000


class SampleBlock(Message):
    """As the rig's block of torque."""

    stamp_ns: Nanoseconds
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    over_phantom: bool
    saturated_count: Count
    torque_n_m: NewtonMetresArray


def block_of(size: int) -> SampleBlock:
    """Return a message whose array has so many bytes, a multiple of 8."""
    torque_n_m = np.sin(np.arange(size // 8) * 0.01) * 1e-3
    torque_n_m.flags.writeable = False
    return SampleBlock(
        stamp_ns=10**9, start_ns=10**9, rate_hz=1e3, over_phantom=True, saturated_count=0,
        torque_n_m=torque_n_m,
    )  # fmt: skip


class _Owner:
    publishing = True
    send_pieces = None

    def now_ns(self) -> int:
        return monotonic_ns()

    def resend(self, frame: bytes) -> None:
        """Nobody asks for a frame again here."""


class Loopback:
    """A publisher's socket and a reader's in this process, with real frames between them.

    Args:
        folder: Where the socket is.
    """

    def __init__(self, folder: str) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        endpoint = f"ipc://{folder}/p"
        self._publisher = PublisherSocket(self._context, endpoint)
        end = PublisherEnd(_TOPIC, SampleBlock, Qos(depth=1), 0, _Owner(), self._publisher.send)
        self._publisher.offer([end])
        self._reader = SubscriberSocket({_TOPIC: endpoint}, self._context, ARRAY_QUEUE)
        self._arrived: list[Frame] = []
        self._header = (_TOPIC.encode(), Kind.DATA, 0, 1, 0, schema_of(SampleBlock).type_hash)
        self._await(lambda: bool(self._publisher.readers))

    def _await(self, done: Callable[[], bool]) -> None:
        until_ns = monotonic_ns() + _PATIENCE_NS
        while not done():
            self._publisher.poll()
            self._reader.dispatch(self._arrive, _SLICE_NS, _WAIT_MS)
            if monotonic_ns() > until_ns:
                raise TimeoutError(
                    f"nothing came through a socket of this process in {_PATIENCE_NS / 1e9:g} s"
                )

    def _arrive(self, raw: bytes, _now_ns: int) -> None:
        frame, rest = parse(raw), self._reader.pieces()
        if frame.kind == Kind.DATA:
            self._arrived.append(frame._replace(rest=tuple(rest)))

    def carry(self, payload: bytes) -> Frame:
        """Send a payload in one frame, and return it as it has come."""
        self._publisher.send(pack(*self._header, payload))
        return self._come()

    def carry_pieces(self, message: Message) -> Frame:
        """Send a message in pieces, whatever its size, and return what has come."""
        pieces = cut(message, 0)
        assert pieces is not None, "it has an array"
        head = pack(*self._header, pieces.head, IN_PIECES)
        self._publisher.send_pieces(self._header[0], head, pieces.body, pieces.tail)
        return self._come()

    def _come(self) -> Frame:
        self._arrived.clear()
        while not self._arrived:
            self._reader.dispatch(self._arrive, _SLICE_NS, _WAIT_MS)
            if not self._arrived:
                self._await(lambda: bool(self._arrived))
        return self._arrived[0]

    def close(self) -> None:
        """Let go."""
        self._reader.close()
        self._context.destroy(linger=0)


@contextmanager
def loopback() -> Iterator[Loopback]:
    """Give a loop in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="palp-") as folder:
        made = Loopback(folder)
        try:
            yield made
        finally:
            made.close()


def ways(along: Loopback) -> dict[str, Callable[[SampleBlock], tuple[Any, int]]]:
    """Return by codec what brings a message to its reader: its array there, and the bytes of its payload."""

    def one_frame(message: SampleBlock) -> tuple[Any, int]:
        frame = along.carry(encode(message))
        return decode(SampleBlock, frame.payload).torque_n_m, frame.payload_bytes

    def pieces(message: SampleBlock) -> tuple[Any, int]:
        frame = along.carry_pieces(message)
        return decode_pieces(SampleBlock, frame.payload, frame.rest).torque_n_m, frame.payload_bytes

    def plain(message: SampleBlock) -> tuple[Any, int]:
        frame = along.carry(encode_plain(message))
        return decode_plain(SampleBlock, frame.payload)["torque_n_m"], frame.payload_bytes

    def text(message: SampleBlock) -> tuple[Any, int]:
        frame = along.carry(encode_json(message))
        return decode_json(SampleBlock, frame.payload)["torque_n_m"], frame.payload_bytes

    return {"msgpack": plain, "one_frame": one_frame, "pieces": pieces, "json": text}


@begins_after(0.1)
def measure_codecs(_scene: Any) -> Iterator[Measured]:
    """Give CPU time per message and size; the error is what travels beside the numbers, a share of them.

    The scene's size is a block's; the larger ones are conditions of their own.
    """
    with loopback() as along:
        for size in SIZES:
            message = block_of(size)
            for name, bring in ways(along).items():
                values, bytes_count = bring(message)
                same = np.array_equal(values, message.torque_n_m)
                strayed = find("codec", name).strayed({"array_bytes": float(size)})
                yield Measured(
                    task="codec",
                    method=name,
                    setting=f"array of {_bytes(size)}",
                    cost_s=cpu_s(lambda b=bring, m=message: b(m), clock=time.process_time_ns),  # type: ignore[misc]
                    error=bytes_count / size - 1.0,
                    output="overhead",
                    against="the array's own bytes",
                    condition="" if size == SIZES[0] else f"array of {_bytes(size)}",
                    fails=strayed if same else "what arrives is not what was sent",
                )


def _bytes(size: int) -> str:
    return f"{size} B" if size < 1 << 10 else f"{size >> 10} KiB" if size < 1 << 20 else f"{size >> 20} MiB"
