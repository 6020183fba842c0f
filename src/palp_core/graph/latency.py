"""A histogram of latencies that costs a list index per message and holds any number of them."""

import math
from array import array
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SUB_BUCKETS = 16
BUCKETS = SUB_BUCKETS * 64
BATCH = 1024
RECENT = 10_000
"""How many of the last durations are known one by one."""
LONGEST_NS = 2**63 - 1
"""What a longer duration counts as: a stamp is what a stranger wrote."""

_FEW = 32  # of which each is sorted in by itself: an array of them costs more
_SHIFT = SUB_BUCKETS.bit_length() - 1


class Latency:
    """Counts durations in buckets a sixteenth of an octave wide: a percentile is within 6 % of the truth.

    The last :data:`RECENT` are kept as they are.
    """

    def __init__(self) -> None:
        self._recent = array("q")
        self._counts = np.zeros(BUCKETS, dtype=np.int64)
        self._new: list[int] = []
        self._max_ns = 0
        self._count = 0

    def add(self, duration_ns: int) -> None:
        """Add one duration; a negative one (two hosts' clocks differ by more than the way) counts as 0."""
        self._new.append(duration_ns)
        if len(self._new) >= BATCH:
            self._sort()

    def _sort(self) -> None:
        """Put what is new into its buckets: in batches, away from the message's way."""
        new, self._new = self._new, []
        if not new:
            return
        if min(new) < 0 or max(new) > LONGEST_NS:
            new = [min(max(duration_ns, 0), LONGEST_NS) for duration_ns in new]
        self._count += len(new)
        if len(new) <= _FEW:
            for duration_ns in new:
                octave = max(duration_ns.bit_length() - _SHIFT - 1, 0)
                self._counts[(octave << _SHIFT) + (duration_ns >> octave)] += 1
            self._max_ns = max(self._max_ns, *new)
            self._recent.extend(new)
        else:
            durations_ns = np.array(new, dtype=np.int64)
            self._counts += np.bincount(_buckets(durations_ns), minlength=BUCKETS)
            self._max_ns = max(self._max_ns, int(durations_ns.max()))
            self._recent.frombytes(durations_ns.tobytes())
        if len(self._recent) > 2 * RECENT:
            del self._recent[:-RECENT]

    @property
    def count(self) -> int:
        return self._count + len(self._new)

    @property
    def max_ns(self) -> int:
        self._sort()
        return self._max_ns

    def percentile_s(self, percent: float) -> float:
        """Return the duration in s that so many per cent do not exceed; 0 when none was added."""
        return self._percentiles_s([percent])[0]

    def _percentiles_s(self, percents: Sequence[float]) -> list[float]:
        self._sort()
        if not self.count:
            return [0.0] * len(percents)
        ranks = [max(self.count * percent / 100.0, 1.0) for percent in percents]
        found = []
        for bucket in np.cumsum(self._counts).searchsorted(ranks).tolist():
            octave = max((bucket >> _SHIFT) - 1, 0)
            upper_ns = (bucket - (octave << _SHIFT) + 1) << octave
            found.append(min(upper_ns, self._max_ns) / 1e9)
        return found

    def summary_s(self) -> dict[str, float]:
        """Return p50, p90, p99 and the maximum, in s."""
        p50, p90, p99 = self._percentiles_s((50, 90, 99))
        return {"p50": p50, "p90": p90, "p99": p99, "max": self._max_ns / 1e9}

    def recent_s(self, window: int) -> dict[str, float]:
        """Return percentiles, extremes, mean and standard deviation of the last ``window``, in s.

        They are :data:`RECENT` at most: ``messages`` says how many.
        """
        self._sort()
        last = sorted(max(ns, 0) for ns in self._recent[-max(min(window, RECENT), 1) :])
        count = len(last)
        ranked = {
            f"p{percent}": last[-(-count * percent // 100) - 1] if last else 0 for percent in (50, 90, 99)
        }
        mean = math.fsum(last) / max(count, 1)
        deviation = math.sqrt(math.fsum((ns - mean) ** 2 for ns in last) / max(count, 1))
        found = {
            **ranked,
            "min": min(last, default=0),
            "max": max(last, default=0),
            "mean": mean,
            "std": deviation,
        }
        return {"messages": count, **{name: value / 1e9 for name, value in found.items()}}


def _buckets(durations_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    bit_length = np.frexp(durations_ns.astype(np.float64))[1]
    octave = np.maximum(bit_length.astype(np.int64) - _SHIFT - 1, 0)
    buckets: NDArray[np.int64] = (octave << _SHIFT) + (durations_ns >> octave)
    return buckets
