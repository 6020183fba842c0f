"""What all contenders do: phases, how a message says where it belongs, and the search for the highest rate.

The index of a message is ``phase << 40 | stage << 32 | number << 1 | asked``; a reader that is asked
replies. So the reader needs no plan, and all contenders share every decision that is not theirs. A contender
whose array has to be of a type of its own makes it before, where it can send the same one again.
"""

from __future__ import annotations

import json
from array import array
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["Arrivals", "Phase", "Search", "index_of", "read_plan", "samples", "write_plan"]

LAG_S = 0.01
TIMEOUT_NS = 3_000_000_000


@dataclass(frozen=True)
class Phase:
    """One measurement.

    Attributes:
        kind: ``stream`` (one-way latency), ``echo`` (each message is replied to), ``call`` (the same as calls
            of a service, palp alone), ``search`` (highest rate).
        size: Bytes of the array, a multiple of 8.
        rate_hz: Of a stream, an echo or calls; where a search begins.
        seconds: Length of a phase; of one stage of a search.
        most: A stage of a search has at most that many messages: fewer than wait in a queue at most.
        resolution: Ratio of rates at which a search ends.
    """

    kind: str
    size: int
    rate_hz: float
    seconds: float
    most: int = 90_000
    resolution: float = 1.03

    @property
    def count(self) -> int:
        """Messages of a phase that is not a search."""
        return max(1, round(self.rate_hz * self.seconds))


def write_plan(folder: Path, phases: list[Phase]) -> None:
    """Put a plan where a contender finds it."""
    text = json.dumps([asdict(phase) for phase in phases])
    (folder / "plan.json").write_text(text, encoding="utf-8")


def read_plan(folder: Path) -> list[Phase]:
    """Return the phases of a plan."""
    return [Phase(**entry) for entry in json.loads((folder / "plan.json").read_text(encoding="utf-8"))]


def samples(size: int) -> NDArray[np.float64]:
    """Return an array of ``size`` bytes of torque, in N m."""
    return np.random.default_rng(1).normal(scale=1e-3, size=size // 8)


def index_of(phase: int, stage: int, number: int, *, asked: bool = False) -> int:
    """Return the index of a message."""
    return phase << 40 | stage << 32 | number << 1 | int(asked)


class Arrivals:
    """The reader's book: index, stamp at the publish call and stamp at arrival of every message it keeps.

    Stages after the first (of a search) are only counted.
    """

    def __init__(self) -> None:
        self.rows = array("q")
        self.count = 0
        self._stage = -1

    def take(self, index: int, sent_ns: int, arrived_ns: int) -> bool:
        """Enter a message; return True if the publisher wants a reply (with ``count``)."""
        stage = index >> 32
        if stage != self._stage:
            self._stage, self.count = stage, 0
        self.count += 1
        if not stage & 0xFF:
            self.rows.extend((index, sent_ns, arrived_ns))
        return bool(index & 1)

    def write(self, path: Path) -> None:
        """Write the rows as an array (message, [index, sent, arrived])."""
        np.save(path, np.frombuffer(self.rows, dtype=np.int64).reshape(-1, 3))


class Search:
    """Find the highest rate at which every message of a stage arrives and nobody falls behind.

    Doubles until a rate fails twice, then halves the interval on a logarithmic scale. A stage fails if a
    message is missing, or if publisher and reader together end more than 10 ms after the rate's own time; the
    same for all contenders.
    """

    def __init__(self, phase: Phase) -> None:
        self.stage = 1
        self.best_hz = 0.0
        self.rate_hz = phase.rate_hz
        self._phase = phase
        self._fails_hz = float("inf")
        self._tried = self._silent = 0

    @property
    def total(self) -> int:
        """Messages of the present stage."""
        return max(2, min(self._phase.most, round(self.rate_hz * self._phase.seconds)))

    @property
    def ideal_ns(self) -> int:
        """Time that the present stage takes at its rate."""
        return round(self.total / self.rate_hz * 1e9)

    @property
    def timeout_ns(self) -> int:
        """When a stage whose end has not been confirmed has failed."""
        return 2 * self.ideal_ns + TIMEOUT_NS

    @property
    def over(self) -> bool:
        """Return whether the rate is known well enough, or nothing arrives any more."""
        known = self._fails_hz / max(self.best_hz, 1.0) < self._phase.resolution
        return known or self._silent == 3 or self.stage > 100

    def judge(self, count: int, took_ns: int) -> None:
        """Take the outcome of a stage: messages arrived, time from its first to the reply to its last."""
        passed = count == self.total and took_ns <= self.ideal_ns + LAG_S * 1e9
        self.stage += 1
        self._tried += 1
        self._silent = 0 if count else self._silent + 1
        if passed:
            self.best_hz = self.rate_hz
        elif self._tried < 2:
            return  # once more: one hiccup of the machine is not a limit
        else:
            self._fails_hz = self.rate_hz
        self._tried = 0
        if self._fails_hz == float("inf"):
            self.rate_hz *= 2.0
        elif self.best_hz == 0.0:
            self.rate_hz /= 2.0
        else:
            self.rate_hz = (self.best_hz * self._fails_hz) ** 0.5
