"""The contender: pyzmq PUB/SUB in its fastest form, one process per end, in three forms.

``one``: one frame, ``[index, sent_ns, bin]`` in msgpack without a topic, packed by a packer that is made
once; from ``ZERO_COPY_FROM`` bytes on two frames, the array sent and received without a copy. No socket has a
receive timeout. ``timeout``: the same, and every socket that reads has one, set once, as a node needs that
must look at its clock, too. ``three``: a frame each for topic, header and array, subscribed to by topic; no
timeout. All: Unix sockets, no high-water mark, so that nothing is dropped. Nothing is validated, counted,
recovered or named.

Run by the bench: ``python raw.py pitcher|catcher FOLDER NUMBER READERS FORM``.
"""

from __future__ import annotations

import gc
import struct
import sys
import time
from pathlib import Path

import msgpack
import numpy as np
import zmq
from drive import Array, Drive
from meter import sign_in
from plan import Arrivals, read_plan

ZERO_COPY_FROM = 1 << 20
COPIED_BELOW = 4096  # bytes; for fewer, a copy is faster than a view
TIMEOUT_MS = 1000
TOPIC = b"/pitcher/block\0"
HEADER = struct.Struct("<qq")
END = -1


def reading(
    context: zmq.Context[zmq.Socket[bytes]], address: str, topic: bytes, form: str
) -> zmq.Socket[bytes]:
    """Return a socket that reads."""
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.setsockopt(zmq.SUBSCRIBE, topic)
    if form == "timeout":
        socket.setsockopt(zmq.RCVTIMEO, TIMEOUT_MS)
    socket.connect(address)
    return socket


class Pitcher(Drive):
    """The publishing end; waits for its readers."""

    def __init__(self, folder: Path, readers: int, form: str) -> None:
        super().__init__(folder)
        self.context = zmq.Context()
        self.publish = self.context.socket(zmq.XPUB)
        self.publish.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.publish.setsockopt(zmq.SNDHWM, 0)
        self.publish.bind(f"ipc://{folder}/raw.pub")
        self.reply = reading(self.context, f"ipc://{folder}/raw0.pub", b"", form)
        self.pack = msgpack.Packer().pack
        for _ in range(readers):
            self.publish.recv()  # a subscription: the reader is there
        while self.receive(0) is None:
            pass  # the first reader's word that this end is heard, too
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
        """Return the next reply; only the socket of the form ``timeout`` waits no longer than its own."""
        try:
            index, sent_ns, count = msgpack.unpackb(self.reply.recv())
        except zmq.Again:
            return None
        return index, sent_ns, count

    def end(self) -> None:
        """Tell the readers to end."""
        self.send(END, np.empty(0))
        self.context.destroy(linger=1000)


class PitcherOfThree(Pitcher):
    """The publishing end that sends topic, header and array in frames of their own."""

    def send(self, index: int, values: Array) -> None:
        send = self.publish.send
        send(TOPIC, zmq.SNDMORE)
        send(HEADER.pack(index, time.monotonic_ns()), zmq.SNDMORE)
        send(values.data, copy=values.nbytes < ZERO_COPY_FROM)


def catch_one(socket: zmq.Socket[bytes], arrivals: Arrivals, reply: zmq.Socket[bytes]) -> None:
    """Read messages of one frame until told to end."""
    pack, unpack = msgpack.Packer().pack, msgpack.unpackb
    while True:
        try:
            message = unpack(socket.recv())
        except zmq.Again:
            continue
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


def catch_three(socket: zmq.Socket[bytes], arrivals: Arrivals, reply: zmq.Socket[bytes], large: bool) -> None:
    """Read messages of three frames until told to end; large arrays without a copy."""
    pack, unpack, recv = msgpack.Packer().pack, HEADER.unpack, socket.recv
    while True:
        recv()
        index, sent_ns = unpack(recv())
        np.frombuffer(recv(copy=False).buffer if large else recv())
        arrived_ns = time.monotonic_ns()
        if index == END:
            return
        if arrivals.take(index, sent_ns, arrived_ns):
            reply.send(pack((index, sent_ns, arrivals.count)))


def catch(folder: Path, number: int, form: str) -> None:
    """Be the reading end until told to end."""
    sign_in(folder)
    context = zmq.Context()
    reply = context.socket(zmq.XPUB)
    reply.bind(f"ipc://{folder}/raw{number}.pub")
    socket = reading(context, f"ipc://{folder}/raw.pub", TOPIC if form == "three" else b"", form)
    if number == 0:
        reply.recv()
        reply.send(msgpack.packb((0, 0, 0)))
    arrivals = Arrivals()
    gc.collect()
    gc.freeze()
    if form == "three":
        large = max(phase.size for phase in read_plan(folder)) >= ZERO_COPY_FROM
        catch_three(socket, arrivals, reply, large)
    else:
        catch_one(socket, arrivals, reply)
    arrivals.write(folder / f"arrivals{number}.npy")
    context.destroy(linger=0)


if __name__ == "__main__":
    role, place, which, reader_count, form_name = sys.argv[1:]
    if role == "pitcher":
        kind = PitcherOfThree if form_name == "three" else Pitcher
        pitcher = kind(Path(place), int(reader_count), form_name)
        pitcher.run()
        pitcher.end()
    else:
        catch(Path(place), int(which), form_name)
