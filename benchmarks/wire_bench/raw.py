"""The contender: pyzmq PUB/SUB in its fastest form, one process per end.

One frame, ``[index, sent_ns, bin]`` in msgpack without a topic, packed by a packer that is made once; from
``ZERO_COPY_FROM`` bytes on two frames, the array sent and received without a copy. Unix sockets without a
receive timeout or a high-water mark, so that nothing is dropped. Nothing is validated, counted, recovered or
named.

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
from meter import sign_in
from plan import Arrivals

ZERO_COPY_FROM = 1 << 20
COPIED_BELOW = 4096  # bytes; for fewer, a copy is faster than a view
END = -1


def reading(context: zmq.Context[zmq.Socket[bytes]], address: str) -> zmq.Socket[bytes]:
    """Return a socket that reads."""
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.setsockopt(zmq.SUBSCRIBE, b"")
    socket.connect(address)
    return socket


class Pitcher(Drive):
    """The publishing end; waits for its readers."""

    def __init__(self, folder: Path, readers: int) -> None:
        super().__init__(folder)
        self.context = zmq.Context()
        self.publish = self.context.socket(zmq.XPUB)
        self.publish.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.publish.setsockopt(zmq.SNDHWM, 0)
        self.publish.bind(f"ipc://{folder}/raw.pub")
        self.reply = reading(self.context, f"ipc://{folder}/raw0.pub")
        self.pack = msgpack.Packer().pack
        for _ in range(readers):
            self.publish.recv()  # a subscription: the reader is there
        self.receive(0)  # the first reader confirms that this end is heard, too
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
        """Return the next reply, however long it takes."""
        index, sent_ns, count = msgpack.unpackb(self.reply.recv())
        return index, sent_ns, count

    def end(self) -> None:
        """Tell the readers to end."""
        self.send(END, np.empty(0))
        self.context.destroy(linger=1000)


def read_all(socket: zmq.Socket[bytes], arrivals: Arrivals, reply: zmq.Socket[bytes]) -> None:
    """Read messages until the publisher ends."""
    pack, unpack = msgpack.Packer().pack, msgpack.unpackb
    while True:
        message = unpack(socket.recv())
        if len(message) == 3:
            index, sent_ns, body = message
            np.frombuffer(body)
        else:
            index, sent_ns = message
            np.frombuffer(socket.recv(copy=False).buffer)
        arrived_ns = time.monotonic_ns()
        if index == END:
            return
        if arrivals.take(index, sent_ns, arrived_ns):
            reply.send(pack((index, sent_ns, arrivals.count)))


def catch(folder: Path, number: int) -> None:
    """Be the reading end until its publisher ends."""
    sign_in(folder)
    context = zmq.Context()
    reply = context.socket(zmq.XPUB)
    reply.bind(f"ipc://{folder}/raw{number}.pub")
    socket = reading(context, f"ipc://{folder}/raw.pub")
    if number == 0:
        reply.recv()
        reply.send(msgpack.packb((0, 0, 0)))
    arrivals = Arrivals()
    gc.collect()
    gc.freeze()
    read_all(socket, arrivals, reply)
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
