"""A time-out that a late reader does not use up: only time in which this process ran counts."""

import time
from collections.abc import Callable


class ReplyTimeout:
    """How long an answer may still be in coming.

    A process that is kept from running (a busy host, a stop signal) finds the clock far ahead and the answer
    perhaps in its buffer: the device was not silent. So each look at the clock uses up no more than
    ``step_s``, twice what a wait takes at most, and a caller looks before the last read, not after it.
    """

    def __init__(
        self, timeout_s: float, step_s: float = 0.04, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._left_s, self._step_s, self._clock = timeout_s, step_s, clock
        self._seen_s = clock()

    def expired(self) -> bool:
        """Return whether the time is used up; read once more before believing it."""
        now_s = self._clock()
        self._left_s -= min(now_s - self._seen_s, self._step_s)
        self._seen_s = now_s
        return self.over

    @property
    def over(self) -> bool:
        """Whether the time was used up at the last look."""
        return self._left_s < 0.0
