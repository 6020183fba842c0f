"""A driver of a device that palp does not know: a load cell whose amplifier sends a line for each sample.

A launch file of the rig has it by ``device: load_cell:LoadCell`` in a workspace that has this file; its
options are the fields below.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import msgspec
import numpy as np

from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.link.serial_link import SerialLink
from palp_core.palpation.devices.link.session_thread import SessionDriver
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.units import Float64Array

BAUD = 460800
LONGEST_LINE = 32


class LoadCellState(msgspec.Struct):
    """What the caller keeps, and hands to whoever takes over: how many samples there were, and the zero."""

    sample_count: int = 0
    zero_n_m: float = 0.0


@dataclass
class LoadCell(SessionDriver):
    """Parameters and link of the amplifier.

    Attributes:
        url: Its port, as pyserial knows it: ``/dev/ttyUSB0``, ``socket://HOST:PORT``.
        rate_hz: Lines a second.
        n_m_per_count: What a count is worth.
        largest_count: Where the converter ends; a sample there is saturated.
        range_n_m: Largest torque that the cell bears.
        stale_s: Longest silence.
    """

    LINK: ClassVar[str] = "load cell: serial at 460800, a line `index,counts` for each sample"
    state_type: ClassVar[type[LoadCellState]] = LoadCellState

    url: str
    rate_hz: float = 1000.0
    n_m_per_count: float = 1.5e-8
    largest_count: int = (1 << 23) - 1
    range_n_m: float = 0.12
    stale_s: float = 0.05

    def __post_init__(self) -> None:
        check_range("load_cell", "rate_hz", self.rate_hz, 1.0, 1000.0)
        check_range("load_cell", "range_n_m", self.range_n_m, 1e-9, 1e3)
        self._prepare("load_cell", self.stale_s)
        self._begin()

    def _begin(self) -> None:
        self._line = SampleLine(self.rate_hz, 1)

    def drain(self, now_ns: int, state: LoadCellState, rng: np.random.Generator) -> TorqueSamples:
        """Return every sample since the last call, those between that were lost marked by a gap."""
        self._host.observe(now_ns)
        stretch = self._line.drain()
        counts = stretch.values[:, 0]
        torque_n_m = counts * self.n_m_per_count - state.zero_n_m
        saturated = (np.abs(counts) >= self.largest_count) | (np.abs(torque_n_m) >= self.range_n_m)
        index = stretch.index + self._first
        if index.size:
            state.sample_count = int(index[-1]) + 1
        return TorqueSamples(
            times_ns=stretch.times_ns,
            torque_n_m=np.clip(torque_n_m, -self.range_n_m, self.range_n_m),
            saturated_count=int(saturated.sum()),
            index=index,
            gap=stretch.gap,
            faulty=saturated,
            clock=stretch.clock,
        )

    def tare(self, block: TorqueSamples, state: LoadCellState) -> Float64Array:
        """Make the mean of a block, read unloaded, the new zero; return it in N m, shape (1,)."""
        state.zero_n_m += float(block.torque_n_m.mean())
        return np.array([state.zero_n_m])

    def _connect(self) -> _Lines:
        return _Lines(self.url, self._line, self._monitor, self._host)


class _Lines:
    """One run of the link, in the receiver's thread; what it raises ends it, and another one is begun."""

    def __init__(self, url: str, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> None:
        self._link = SerialLink("load_cell", url, BAUD)
        self._line, self._monitor, self._host = line, monitor, host
        self._rest = b""
        self._ahead: int | None = None  # our number of a sample, less the device's; None: not one was heard

    def step(self, stop: threading.Event) -> None:
        data = self._link.read_some()
        now_ns = self._host.now_ns()
        *lines, self._rest = (self._rest + data).split(b"\n")
        samples = [sample for sample in map(_sample, lines) if sample is not None]
        if len(samples) < len(lines) or len(self._rest) > LONGEST_LINE:
            if self._ahead is not None:  # the first line may have begun before we listened
                self._monitor.report(Condition.GARBLED, now_ns, f"{data[:20]!r} is no line of index,counts")
            self._rest = self._rest[-LONGEST_LINE:]
        if not samples:
            return
        index, counts = (np.array(column) for column in zip(*samples, strict=True))
        if self._ahead is None or index[0] + self._ahead < 0:
            self._ahead = self._line.restart_numbering(len(samples), now_ns) - int(index[0])
        breaks = [0, *(np.flatnonzero(np.diff(index) != 1) + 1), len(index)]
        for first, end in pairwise(breaks):
            self._line.append(
                counts[first:end, None].astype(np.float64), now_ns, int(index[first]) + self._ahead
            )
        self._monitor.note_data(now_ns)

    def close(self) -> None:
        self._link.close()


def _sample(line: bytes) -> tuple[int, int] | None:
    """Return index and counts of a line; None if it is none."""
    try:
        index, counts = map(int, line.split(b","))
    except ValueError:
        return None
    return index, counts
