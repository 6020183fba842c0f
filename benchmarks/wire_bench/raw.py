"""The contender: pyzmq PUB/SUB and msgpack in their fastest form, one process per end.

One frame, ``[index, sent_ns, bin]`` without a topic, packed by a packer that is made once, no high-water
mark; from ``ZERO_COPY_FROM`` bytes on two frames, the array sent and received without a copy. Nothing is
validated, counted, recovered or named.

Run by the bench: ``python raw.py pitcher|catcher FOLDER NUMBER READERS``.
"""

from __future__ import annotations

import gc
import sys
import time
from pathlib import Path

import msgpack
import numpy as np
import zmq
from drive import Array, Drive
from plan import Arrivals

ZERO_COPY_FROM = 1 << 20
COPIED_BELOW = 4096  # bytes; for fewer, a copy is faster than a view


class Pitcher(Drive):
    """The publishing end; waits for its readers."""

    def __init__(self, folder: Path, readers: int) -> None:
        super().__init__(folder)
        self.context = zmq.Context()
        self.publish = self.context.socket(zmq.XPUB)
        self.publish.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.publish.setsockopt(zmq.SNDHWM, 0)
        self.publish.bind(f"ipc://{folder}/raw.pub")
        self.reply = self.context.socket(zmq.SUB)
        self.reply.setsockopt(zmq.RCVHWM, 0)
        self.reply.setsockopt(zmq.SUBSCRIBE, b"")
        self.reply.connect(f"ipc://{folder}/raw0.pub")
        self.pack = msgpack.Packer().pack
        for _ in range(readers):
            self.publish.recv()  # a subscription: the reader is there
        self.reply.recv()
        gc.collect()
        gc.freeze()

    def send(self, index: int, values: Array) -> None:
        if values.nbytes < ZERO_COPY_FROM:
            body = values.tobytes() if values.nbytes < COPIED_BELOW else values.data
            self.publish.send(self.pack((index, time.monotonic_ns(), body)))
        else:
            self.publish.send(self.pack((index, time.monotonic_ns())), zmq.SNDMORE)
            self.publish.send(values.data, copy=False)

    def receive(self, timeout_ns: int) -> tuple[int, int, int] | None:
        self.reply.setsockopt(zmq.RCVTIMEO, timeout_ns // 10**6 + 1)
        try:
            index, sent_ns, count = msgpack.unpackb(self.reply.recv())
        except zmq.Again:
            return None
        return index, sent_ns, count

    def end(self) -> None:
        """Tell the readers to end."""
        self.publish.send(self.pack((-1, 0, b"")))
        self.context.destroy(linger=1000)


def catch(folder: Path, number: int) -> None:
    """Be the reading end until told to end."""
    context = zmq.Context()
    reply = context.socket(zmq.XPUB)
    reply.bind(f"ipc://{folder}/raw{number}.pub")
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.setsockopt(zmq.SUBSCRIBE, b"")
    socket.connect(f"ipc://{folder}/raw.pub")
    if number == 0:
        reply.recv()
        reply.send(msgpack.packb((0, 0, 0)))
    arrivals, pack, unpack = Arrivals(), msgpack.Packer().pack, msgpack.unpackb
    gc.collect()
    gc.freeze()
    while True:
        message = unpack(socket.recv())
        if len(message) == 3:
            index, sent_ns, body = message
            np.frombuffer(body)
        else:
            index, sent_ns = message
            np.frombuffer(socket.recv(copy=False).buffer)
        arrived_ns = time.monotonic_ns()
        if index < 0:
            break
        if arrivals.take(index, sent_ns, arrived_ns):
            reply.send(pack((index, sent_ns, arrivals.count)))
    arrivals.write(folder / f"arrivals{number}.npy")
    context.destroy(linger=0)


if __name__ == "__main__":
    role, place, which, reader_count = sys.argv[1:]
    if role == "pitcher":
        pitcher = Pitcher(Path(place), int(reader_count))
        pitcher.run()
        pitcher.end()
    else:
        catch(Path(place), int(which))
