"""Cut the torque of one sweep out of a stream, on an even grid of time."""

import msgspec
import numpy as np

from palp_core.units import Float64Array

_KEEP_NS = 1_000_000_000


class SweepCut(msgspec.Struct):
    """The last second of a stream, and all of it while a sweep is under way; plain data for a successor."""

    held: bool = False  # Whether a sweep is under way
    starts_ns: list[int] = []  # Time of each block's first sample
    rates_hz: list[float] = []  # Rate within each block
    blocks: list[bytes] = []  # Samples of each block as bytes
    enter_ns: int = 0  # When the sweep came over the interval; 0 while not known
    leave_ns: int = 0  # When it left it
    last_ns: int = 0  # Time of the latest sample

    def add(self, start_ns: int, rate_hz: float, torque_n_m: Float64Array) -> None:
        """Add a block."""
        self.starts_ns.append(start_ns)
        self.rates_hz.append(rate_hz)
        self.blocks.append(torque_n_m.tobytes())
        self.last_ns = start_ns + round((len(torque_n_m) - 1) * 1e9 / rate_hz)
        while not self.held and len(self.blocks) > 1 and self.starts_ns[0] < self.last_ns - _KEEP_NS:
            del self.starts_ns[0], self.rates_hz[0], self.blocks[0]

    def hold(self, enter_ns: int = 0, leave_ns: int = 0) -> None:
        """Begin a sweep: keep everything from now on, and the second before; its times may be foretold."""
        self.held, self.enter_ns, self.leave_ns = True, enter_ns, leave_ns

    def release(self) -> None:
        """End a sweep."""
        self.held, self.enter_ns, self.leave_ns = False, 0, 0

    def bound(self, enter_ns: int, leave_ns: int) -> None:
        """Say when the sweep was over the interval."""
        self.enter_ns, self.leave_ns = enter_ns, leave_ns

    @property
    def complete(self) -> bool:
        """Whether the stream has passed the end of the interval."""
        return 0 < self.leave_ns <= self.last_ns

    def since(self, rate_hz: float, count: int) -> tuple[int, Float64Array]:
        """Return the time of the grid's first sample, and its samples after the first ``count``, so far.

        A sample is there once the stream has one at or beyond it, and is linear between those.
        """
        first = int(-(-self.enter_ns * rate_hz // 1e9))
        last = int(min(self.leave_ns, self.last_ns) * rate_hz // 1e9)
        start_ns = self.enter_ns + round((first / rate_hz - self.enter_ns * 1e-9) * 1e9)
        if last < first + count:
            return start_ns, np.empty(0)
        times_s, torque_n_m = self._samples()
        grid_s = np.arange(first + count, last + 1) / rate_hz - self.enter_ns * 1e-9
        if times_s[0] > grid_s[0]:
            raise ValueError("no torque came while the stage swept; is the sensor's stream running?")
        return start_ns, np.interp(grid_s, times_s, torque_n_m)

    def largest_gap_s(self, rate_hz: float) -> float:
        """Return the longest time between two samples of the stream that the grid spans."""
        times_s, _ = self._samples()
        most_s, step_s = (min(self.leave_ns, self.last_ns) - self.enter_ns) * 1e-9, 1.0 / rate_hz
        within = times_s[(times_s >= -step_s) & (times_s <= most_s + step_s)]
        if len(within) < 2:
            raise ValueError("no torque came while the stage swept; is the sensor's stream running?")
        return float(np.max(np.diff(within)))

    def _samples(self) -> tuple[Float64Array, Float64Array]:
        """Return times in s from entering, and torques, both in order."""
        parts = [np.frombuffer(block, dtype=np.float64) for block in self.blocks]
        times_s = np.concatenate(
            [
                (start_ns - self.enter_ns) * 1e-9 + np.arange(len(part)) / rate_hz
                for start_ns, rate_hz, part in zip(self.starts_ns, self.rates_hz, parts, strict=True)
            ]
        )
        order = np.argsort(times_s, kind="stable")
        return times_s[order], np.concatenate(parts)[order]
