"""Whether a sensor sends as many samples as it is said to: drivers make times of samples with that rate."""

WATCHED_NS = 2_000_000_000
"""How long samples are counted, from the first that come."""

TOLERANCE = 0.2
"""Of the rate: less is what a bus that stumbles, or a machine that stands still for a moment, loses."""


class SeenRate:
    """Counts what comes in the first two seconds."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._begin_ns: int | None = None
        self._count = 0
        self._told = False

    def note(self, now_ns: int, count: int) -> str | None:
        """Count samples; return in words, once, that another number of them comes.

        >>> seen = SeenRate(1000.0)
        >>> seen.note(0, 1), seen.note(1_000_000_000, 200)
        (None, None)
        >>> seen.note(2_000_000_000, 200)
        'about 200 samples come a second, and rate_hz is 1000, by which they are timed: set rate_hz: 200'
        """
        if self._told or (self._begin_ns is None and not count):
            return None
        if self._begin_ns is None:
            self._begin_ns = now_ns  # what had waited is of before
            return None
        self._count += count
        watched_ns = now_ns - self._begin_ns
        if watched_ns < WATCHED_NS:
            return None
        self._told = True
        seen_hz = float(f"{self._count / (watched_ns * 1e-9):.3g}")
        if abs(seen_hz - self._rate_hz) <= TOLERANCE * self._rate_hz:
            return None
        return (
            f"about {seen_hz:g} samples come a second, and rate_hz is {self._rate_hz:g}, by which they are "
            f"timed: set rate_hz: {seen_hz:g}"
        )
