"""ezmsg, by its low-level interface (publishers and subscribers without units), one process per end.

Reliable: a publisher waits for a reader that is slow. The array travels in shared memory and is read there,
without a copy (``recv_zero_copy``); one below 4 KiB as bytes, which are pickled faster. The graph's server is
a thread of the publisher's process and idle while messages pass. All is asyncio, as ezmsg is, on a selector
that sleeps to the microsecond (epoll, the default, rounds up to milliseconds).

Run by the bench, with a Python that has it:
``python ezmsg_ends.py pitcher|catcher FOLDER NUMBER READERS``.
"""

from __future__ import annotations

import asyncio
import gc
import selectors
import sys
import time
from pathlib import Path
from typing import Any

import ezmsg.core as ez
import numpy as np
from drive import PATIENCE_NS, PAUSE_NS, TICK_NS, Array, Drive, sleep_until
from meter import sign_in
from plan import Arrivals, Phase, Search, index_of, read_plan, samples

END = -1
COPIED_BELOW = 4096
HOST = "127.0.0.1"
HEAD_BYTES = 4096
GLANCE_NS = 10_000_000


async def rest(due_ns: int) -> None:
    """Sleep until a time on the host's monotonic clock, and let others work."""
    await asyncio.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)


class Pitcher(Drive):
    """The publishing end; what the other contenders do by blocking, it awaits."""

    def __init__(self, folder: Path, publisher: Any, replies: Any) -> None:
        super().__init__(folder)
        self.publisher = publisher
        self.replies = replies

    def send(self, index: int, values: Array) -> None:
        raise NotImplementedError("it publishes by ``broadcast``")

    def receive(self, timeout_ns: int) -> tuple[int, int, int] | None:
        raise NotImplementedError("it receives by ``hear``")

    async def broadcast(self, index: int, values: Array) -> None:
        """Publish a message."""
        body = values.tobytes() if values.nbytes < COPIED_BELOW else values
        await self.publisher.broadcast((index, time.monotonic_ns(), body))

    async def hear(self, timeout_ns: int) -> tuple[int, int, int] | None:
        """Return the next reply; None if none comes in time."""
        try:
            async with asyncio.timeout(timeout_ns / 1e9), self.replies.recv_zero_copy() as reply:
                return reply  # type: ignore[no-any-return]
        except TimeoutError:
            return None

    async def play(self) -> None:
        """Go through the phases."""
        for at, phase in enumerate(read_plan(self.folder)):
            await rest(time.monotonic_ns() + PAUSE_NS)
            if phase.kind == "search":
                self.rates[at] = await self._seek(at, phase, samples(phase.size))
            else:
                await self._flow(at, phase, samples(phase.size))
        self.write()
        await rest(time.monotonic_ns() + PAUSE_NS)

    async def _flow(self, at: int, phase: Phase, values: Array) -> None:
        asked = phase.kind == "echo"
        self.meter.begin()
        begin_ns = time.monotonic_ns()
        for number in range(1, phase.count + 1):
            await rest(begin_ns + round(number * 1e9 / phase.rate_hz))
            await self.broadcast(index_of(at, 0, number, asked=asked), values)
            if asked and (reply := await self.hear(PATIENCE_NS)) is not None:
                self.trips.extend((reply[0], reply[1], time.monotonic_ns()))
        await rest(begin_ns + round((phase.count + 1) * 1e9 / phase.rate_hz))
        self.meter.end(at)

    async def _seek(self, at: int, phase: Phase, values: Array) -> float:
        search = Search(phase)
        while not search.over:
            total, stage, rate_hz = search.total, search.stage, search.rate_hz
            begin_ns = tick_ns = time.monotonic_ns()
            number = 0
            while number < total:
                due = min(total, int((time.monotonic_ns() - begin_ns) * rate_hz / 1e9) + 1)
                while number < due:
                    number += 1
                    await self.broadcast(index_of(at, stage, number, asked=number == total), values)
                tick_ns += TICK_NS
                await rest(tick_ns)
            count, until_ns = 0, begin_ns + search.timeout_ns
            while not count and (left_ns := until_ns - time.monotonic_ns()) > 0:
                reply = await self.hear(left_ns)
                if reply is not None and reply[0] >> 32 == at << 8 | stage:
                    count = reply[2]
            search.judge(count, time.monotonic_ns() - begin_ns)
        return search.best_hz


async def pitch(folder: Path, readers: int) -> None:
    """Be the publishing end, and the graph's server."""
    server = ez.GraphServer()
    server.start((HOST, 0))
    largest = max(phase.size for phase in read_plan(folder))
    try:
        async with ez.GraphContext(server.address, auto_start=False) as context:
            publisher = await context.publisher("block", buf_size=largest + HEAD_BYTES)
            replies = await context.subscriber("reply")
            pitcher = Pitcher(folder, publisher, replies)
            (folder / "port.new").write_text(str(server.address[1]), encoding="utf-8")
            (folder / "port.new").rename(folder / "port")
            for _ in range(readers):
                while await pitcher.hear(PATIENCE_NS) is None:
                    pass
            gc.collect()
            gc.freeze()
            await pitcher.play()
            await pitcher.broadcast(END, np.empty(0))
            for _ in range(readers):
                await pitcher.hear(PATIENCE_NS)
    finally:
        server.stop()


async def catch(folder: Path, number: int) -> None:
    """Be the reading end until told to end."""
    sign_in(folder)
    while not (folder / "port").exists():
        sleep_until(time.monotonic_ns() + GLANCE_NS)
    address = (HOST, int((folder / "port").read_text(encoding="utf-8")))
    arrivals = Arrivals()
    async with ez.GraphContext(address, auto_start=False) as context:
        messages = await context.subscriber("block")
        reply = await context.publisher("reply")
        await reply.broadcast((0, 0, number))
        gc.collect()
        gc.freeze()
        index = 0
        while index != END:
            async with messages.recv_zero_copy() as message:
                index, sent_ns, body = message
                if type(body) is bytes:
                    np.frombuffer(body)
                arrived_ns = time.monotonic_ns()
                del message, body  # nothing may look into memory that is given back
            if index != END and arrivals.take(index, sent_ns, arrived_ns) and number == 0:
                await reply.broadcast((index, sent_ns, arrivals.count))
        arrivals.write(folder / f"arrivals{number}.npy")
        await reply.broadcast((END, 0, number))


if __name__ == "__main__":
    role, place, which, reader_count = sys.argv[1:]
    ends = pitch(Path(place), int(reader_count)) if role == "pitcher" else catch(Path(place), int(which))
    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
        runner.run(ends)
