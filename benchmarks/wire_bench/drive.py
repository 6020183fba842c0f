"""The publishing end of a contender that is a plain script: everything but how a message is sent."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from array import array
from pathlib import Path
from typing import Any

import numpy as np
from meter import Meter
from plan import Phase, Search, index_of, read_plan, samples

__all__ = ["PATIENCE_NS", "PAUSE_NS", "TICK_NS", "Array", "Drive", "sleep_until"]

TICK_NS = 1_000_000
PAUSE_NS = 100_000_000
PATIENCE_NS = 1_000_000_000

Array = np.ndarray[Any, np.dtype[np.float64]]


def sleep_until(due_ns: int) -> None:
    """Sleep until a time on the host's monotonic clock."""
    left_ns = due_ns - time.monotonic_ns()
    if left_ns > 0:
        time.sleep(left_ns / 1e9)  # noqa: TID251 - the contender's own pace; there is no event to wait for


class Drive(ABC):
    """Goes through the phases of a plan and writes what it finds."""

    phase: Phase  # the present one

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.trips = array("q")
        self.rates = dict[int, float]()
        self.meter = Meter(folder)

    @abstractmethod
    def send(self, index: int, values: Array) -> None:
        """Publish a message, stamped just before the call."""

    @abstractmethod
    def receive(self, timeout_ns: int) -> tuple[int, int, int] | None:
        """Return the next reply: index, stamp of the message, count; None if none comes in time."""

    def run(self) -> None:
        """Go through the phases."""
        for at, phase in enumerate(read_plan(self.folder)):
            self.phase = phase
            sleep_until(time.monotonic_ns() + PAUSE_NS)
            if phase.kind == "search":
                self.rates[at] = self._search(at, phase, samples(phase.size))
            else:
                self._stream(at, phase, samples(phase.size))
        self.write()
        sleep_until(time.monotonic_ns() + PAUSE_NS)

    def write(self) -> None:
        """Write what was found."""
        np.save(self.folder / "trips.npy", np.frombuffer(self.trips, dtype=np.int64).reshape(-1, 3))
        np.save(self.folder / "rates.npy", np.array(sorted(self.rates.items()), dtype=float).reshape(-1, 2))
        self.meter.write()

    def _stream(self, at: int, phase: Phase, values: Array) -> None:
        asked = phase.kind == "echo"
        self.meter.begin()
        begin_ns = time.monotonic_ns()
        for number in range(1, phase.count + 1):
            sleep_until(begin_ns + round(number * 1e9 / phase.rate_hz))
            self.send(index_of(at, 0, number, asked=asked), values)
            if asked and (reply := self.receive(PATIENCE_NS)) is not None:
                self.trips.extend((reply[0], reply[1], time.monotonic_ns()))
        sleep_until(begin_ns + round((phase.count + 1) * 1e9 / phase.rate_hz))  # the last one arrives, too
        self.meter.end(at)

    def _search(self, at: int, phase: Phase, values: Array) -> float:
        search = Search(phase)
        while not search.over:
            total, stage, rate_hz = search.total, search.stage, search.rate_hz
            begin_ns = tick_ns = time.monotonic_ns()
            number = 0
            while number < total:
                due = min(total, int((time.monotonic_ns() - begin_ns) * rate_hz / 1e9) + 1)
                while number < due:
                    number += 1
                    self.send(index_of(at, stage, number, asked=number == total), values)
                tick_ns += TICK_NS
                sleep_until(tick_ns)
            count = self._replied(at << 8 | stage, begin_ns + search.timeout_ns)
            search.judge(count, time.monotonic_ns() - begin_ns)
        return search.best_hz

    def _replied(self, stage: int, until_ns: int) -> int:
        while (left_ns := until_ns - time.monotonic_ns()) > 0:
            reply = self.receive(left_ns)
            if reply is not None and reply[0] >> 32 == stage:
                return reply[2]
        return 0
