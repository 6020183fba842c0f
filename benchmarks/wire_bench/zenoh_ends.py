"""zenoh (the Python API of Eclipse Zenoh), reliable, one process per end.

Peers that know each other's address, a Unix socket: no scouting, no gossip, no router. Publishers block when
the way is congested, so that nothing is dropped. A stream is sent ``express``, at once; a search for the
highest rate in batches. Readers are called directly by zenoh's receiving thread, the shortest way into
Python. Shared memory is on, with its defaults, by which zenoh itself sends a large message through it. The
array is converted to zenoh's own bytes before, as these can be sent again; stamp and index are the message's
attachment, so that the array need not be copied behind them.

Run by the bench, with a Python that has it:
``python zenoh_ends.py pitcher|catcher FOLDER NUMBER READERS``.
"""

from __future__ import annotations

import gc
import json
import queue
import struct
import sys
import threading
import time
from pathlib import Path

import numpy as np
import zenoh
from drive import Array, Drive, sleep_until
from meter import sign_in
from plan import Arrivals

HEAD = struct.Struct("<qqq")  # index, stamp, count
END = -1
GLANCE_NS = 10_000_000


def opened(folder: Path, kind: str) -> zenoh.Session:
    """Open a session that ``listen``s, or ``connect``s to the one that does."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("peer"))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    for each in ("listen", "connect"):
        endpoints = [f"unixsock-stream/{folder}/zenoh.sock"] if each == kind else []
        config.insert_json5(f"{each}/endpoints", json.dumps(endpoints))
    return zenoh.open(config)


def publisher(session: zenoh.Session, key: str, *, express: bool) -> zenoh.Publisher:
    """Return a publisher that loses nothing."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        reliability=zenoh.Reliability.RELIABLE,
        express=express,
    )


class Pitcher(Drive):
    """The publishing end; waits for its readers."""

    def __init__(self, folder: Path, readers: int) -> None:
        super().__init__(folder)
        self.session = opened(folder, "listen")
        self.express = publisher(self.session, "wires/block", express=True)
        self.batched = publisher(self.session, "wires/block", express=False)
        self.replies: queue.SimpleQueue[tuple[int, int, int]] = queue.SimpleQueue()
        hear = zenoh.handlers.Callback(self._hear, indirect=False)
        self.hearing = self.session.declare_subscriber("wires/reply", hear)
        there = set[str]()
        tokens = zenoh.handlers.Callback(lambda sample: there.add(str(sample.key_expr)), indirect=False)
        self.watching = self.session.liveliness().declare_subscriber("wires/there/*", tokens, history=True)
        while len(there) < readers:
            sleep_until(time.monotonic_ns() + GLANCE_NS)
        self.bodies: dict[int, zenoh.ZBytes] = {}
        gc.collect()
        gc.freeze()

    def _hear(self, sample: zenoh.Sample) -> None:
        self.replies.put(HEAD.unpack(sample.payload.to_bytes()))

    def send(self, index: int, values: Array) -> None:
        body = self.bodies.get(values.nbytes)
        if body is None:
            body = self.bodies[values.nbytes] = zenoh.ZBytes(values.tobytes())
        put = self.batched.put if self.phase.kind == "search" else self.express.put
        put(body, attachment=HEAD.pack(index, time.monotonic_ns(), 0))

    def receive(self, timeout_ns: int) -> tuple[int, int, int] | None:
        try:
            return self.replies.get(timeout=timeout_ns / 1e9)
        except queue.Empty:
            return None

    def end(self) -> None:
        """Tell the readers to end."""
        self.express.put(b"", attachment=HEAD.pack(END, 0, 0))
        sleep_until(time.monotonic_ns() + 300_000_000)
        self.session.close()


def catch(folder: Path, number: int) -> None:
    """Be the reading end until told to end."""
    sign_in(folder)
    while not (folder / "zenoh.sock").exists():
        sleep_until(time.monotonic_ns() + GLANCE_NS)
    session = opened(folder, "connect")
    reply = publisher(session, "wires/reply", express=True)
    arrivals, done = Arrivals(), threading.Event()

    def take(sample: zenoh.Sample) -> None:
        np.frombuffer(sample.payload.to_bytes())
        arrived_ns = time.monotonic_ns()
        index, sent_ns, _ = HEAD.unpack(sample.attachment.to_bytes())
        if index == END:
            done.set()
        elif arrivals.take(index, sent_ns, arrived_ns) and number == 0:
            reply.put(HEAD.pack(index, sent_ns, arrivals.count))

    reading = session.declare_subscriber("wires/block", zenoh.handlers.Callback(take, indirect=False))
    token = session.liveliness().declare_token(f"wires/there/{number}")  # told after the subscription
    gc.collect()
    gc.freeze()
    done.wait()
    arrivals.write(folder / f"arrivals{number}.npy")
    token.undeclare()
    reading.undeclare()
    session.close()


if __name__ == "__main__":
    role, place, which, reader_count = sys.argv[1:]
    if role == "pitcher":
        pitcher = Pitcher(Path(place), int(reader_count))
        pitcher.run()
        pitcher.end()
    else:
        catch(Path(place), int(which))
