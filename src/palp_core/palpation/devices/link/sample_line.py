"""Samples on their way from a driver's thread to its caller: numbered, stamped, gaps marked."""

import threading
from dataclasses import dataclass

import numpy as np

from palp_core.palpation.devices.link.clock_model import ClockModel
from palp_core.palpation.devices.protocols import BoolArray, ClockFit, Int64Array
from palp_core.units import Float64Array

_NS = 1e9


@dataclass(frozen=True, eq=False)
class Stretch:
    """What was received since the last drain: arrays (n,), values (n, channels)."""

    times_ns: Int64Array
    index: Int64Array
    gap: BoolArray
    values: Float64Array
    clock: ClockFit


class SampleLine:
    """Number the samples of one device and give them host times by a clock model.

    A device with a sequence number gives the number of its first sample with each chunk. One without has
    only its rate: the line compares how many samples came with how many the time allows. A chunk may be late
    without loss, so samples count as lost only when even the earliest arrival over ``patience_s`` is later
    than the model by ``gap_s``; reported loss (:meth:`mark_gap`) counts at once. Nothing that is that late
    teaches the clock model, or one silence would spoil a minute of stamps.
    """

    def __init__(
        self, rate_hz: float, channel_count: int, gap_s: float = 0.05, patience_s: float = 0.5
    ) -> None:
        self._rate_hz, self._channel_count = rate_hz, channel_count
        self._gap_ns, self._patience_ns = round(gap_s * _NS), round(patience_s * _NS)
        self._clock = ClockModel()
        self._lock = threading.Lock()
        self._chunks: list[tuple[int, Float64Array, bool]] = []
        self._next = 0
        self._broken = False
        self._earliest_ns: int | None = None
        self._since_ns = 0
        self.received_count = 0
        self.lost_count = 0

    def append(self, values: Float64Array, host_ns: int, first_index: int | None = None) -> None:
        """Append samples, shape (n, channels), whose last was received at ``host_ns``."""
        count = len(values)
        if not count:
            return
        with self._lock:
            gap = self._broken
            if first_index is None:
                gap |= self._skip_lost(count, host_ns)
                first_index = self._next
            elif self.received_count and first_index != self._next:
                gap = True
                self.lost_count += max(0, first_index - self._next)
            self._broken = False
            self._chunks.append((first_index, values, gap))
            self._next = first_index + count
            self.received_count += count
            if self._earliest_ns is None:
                self._clock.observe((self._next - 1) / self._rate_hz, host_ns)

    def restart_numbering(self, count: int, host_ns: int) -> int:
        """Return the number of the next sample, of a device that numbers its samples from 0 again.

        What the time would have given since the last one is lost; the clock is learnt again.
        """
        with self._lock:
            if self.received_count:
                skipped = max(0, round(self._late_ns(count, host_ns) * self._rate_hz / _NS))
                self._next += skipped
                self.lost_count += skipped
                self._broken, self._earliest_ns = True, None
                self._clock.restart()
            return self._next

    def mark_gap(self) -> None:
        """Mark that something was lost before the next sample."""
        with self._lock:
            self._broken = self.received_count > 0

    def drain(self) -> Stretch:
        """Return everything since the last call."""
        with self._lock:
            chunks, self._chunks = self._chunks, []
            if not chunks:
                empty = np.empty(0, dtype=np.int64)
                return Stretch(
                    empty, empty, empty.astype(np.bool_), np.empty((0, self._channel_count)), self._clock.fit
                )
            index = np.concatenate([np.arange(first, first + len(values)) for first, values, _ in chunks])
            gap = np.zeros(len(index), dtype=np.bool_)
            starts = np.cumsum([0, *(len(values) for _, values, _ in chunks[:-1])])
            gap[starts] = [marked for _, _, marked in chunks]
            times_ns = self._clock.host_ns(index / self._rate_hz)
            return Stretch(
                times_ns, index, gap, np.concatenate([values for _, values, _ in chunks]), self._clock.fit
            )

    def _skip_lost(self, count: int, host_ns: int) -> bool:
        """Jump over samples that did not come in time; return whether there were any."""
        if not self.received_count:
            return False
        late_ns = self._late_ns(count, host_ns)
        if late_ns < self._gap_ns:
            self._earliest_ns = None
            return False
        if self._earliest_ns is None:
            self._earliest_ns, self._since_ns = late_ns, host_ns
        self._earliest_ns = min(self._earliest_ns, late_ns)
        patient = host_ns - self._since_ns >= self._patience_ns
        if not (patient or self._broken):
            return False
        skipped = round((self._earliest_ns if patient else late_ns) * self._rate_hz / _NS)
        self._next += skipped
        self.lost_count += skipped
        self._earliest_ns = None
        return skipped > 0

    def _late_ns(self, count: int, host_ns: int) -> int:
        """Return how much later than the model the last of the next samples came."""
        fit = self._clock.fit
        return host_ns - (
            fit.offset_ns + round((self._next + count - 1) / self._rate_hz * (1.0 + fit.drift) * _NS)
        )
