"""Compare the stage's positions on two links: does the safety node's own one lead to this stage?"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from palp_core.palpation.devices.protocols import AxisReport, Direction

CHECK_MOVE_M = 3e-3
"""A move of the stage, above the phantom, that shows whether the link follows it."""
FOLLOWED_M = 0.5 * CHECK_MOVE_M
"""Way over which an axis must have followed the stage to count as verified."""
_APART_M = 0.5e-3  # assumed: the same encoder is read twice
_CLOCKS_NS = 5_000_000  # how far the two processes' estimates of the graph's time may be apart
_KEPT = 1000  # places of the stage; 20 s at 50 Hz


class StagePlace(NamedTuple):
    """Where the stage's node has seen the stage, and between which times."""

    asked_ns: int
    answered_ns: int
    y_m: float
    z_m: float
    x_m: float = 0.0

    def at_m(self, direction: Direction) -> float:
        """Return its place in a direction."""
        return {"y": self.y_m, "z": self.z_m, "x": self.x_m}[direction]


@dataclass
class _Followed:
    """Places between which an axis has followed the stage, and when it was last seen to."""

    low_m: float
    high_m: float
    seen_ns: int

    @property
    def way_m(self) -> float:
        return self.high_m - self.low_m


class LinkCheck:
    """Compare where the stage's node sees the stage with where the safety node's own link sees its axes.

    An answer on the own link lies between two places of the stage. In the time between these the stage has
    moved no further than its speed allows, which bounds the answer, however late any message comes: a busy
    host makes the bounds wide and never wrong. An axis is verified when its own answers have moved by
    ``FOLLOWED_M`` and all of them were within their bounds.
    """

    def __init__(self, speed_m_per_s: float) -> None:
        self._speed_m_per_s = speed_m_per_s
        self.forget()

    def forget(self) -> None:
        """Begin again: the stage or the own link has been connected again."""
        self._places: deque[StagePlace] = deque(maxlen=_KEPT)
        self._waiting: deque[AxisReport] = deque(maxlen=_KEPT)
        self._followed: dict[Direction, _Followed] = {}
        self._contradictions: dict[Direction, str] = {}

    @property
    def contradiction(self) -> str:
        """How the latest answer of an axis contradicts the stage; empty: none does."""
        return next(iter(self._contradictions.values()), "")

    def result(self, direction: Direction) -> str:
        """Return what is known of an axis, as a text."""
        followed = self._followed.get(direction)
        way_mm = followed.way_m * 1e3 if followed else 0.0
        enough = "" if self.verified_ns(direction) else f", {FOLLOWED_M * 1e3:g} mm are needed"
        return self._contradictions.get(direction) or f"followed the stage over {way_mm:.1f} mm{enough}"

    def note_stage(self, place: StagePlace) -> None:
        """Take note of where the stage is; ``answered_ns`` 0 says that it is not connected."""
        if not place.answered_ns:
            self.forget()
        elif not self._places or place.asked_ns > self._places[-1].answered_ns:
            self._places.append(place)
            self._compare()

    def note_axis(self, report: AxisReport) -> None:
        """Take note of an answer on the own link."""
        self._waiting.append(report)
        self._compare()

    def verified_ns(self, direction: Direction) -> int:
        """Return when the axis was last seen to follow the stage; 0: it has not been yet."""
        followed = self._followed.get(direction)
        verified = followed and followed.way_m >= FOLLOWED_M and direction not in self._contradictions
        return followed.seen_ns if followed and verified else 0

    def _compare(self) -> None:
        """Compare every answer that lies between two places of the stage."""
        while self._waiting and self._places and self._waiting[0].answered_ns <= self._places[-1].asked_ns:
            report = self._waiting.popleft()
            before = next((p for p in reversed(self._places) if p.answered_ns <= report.asked_ns), None)
            if before is not None:
                after = next(place for place in self._places if place.asked_ns >= report.answered_ns)
                self._judge(report, before, after)

    def _judge(self, report: AxisReport, before: StagePlace, after: StagePlace) -> None:
        direction, at_m = report.direction, report.position_m
        ends_m = before.at_m(direction), after.at_m(direction)
        span_s = (after.answered_ns - before.asked_ns + _CLOCKS_NS) * 1e-9
        beyond_m = 0.5 * max(0.0, self._speed_m_per_s * span_s - abs(ends_m[1] - ends_m[0])) + _APART_M
        if not min(ends_m) - beyond_m <= at_m <= max(ends_m) + beyond_m:
            self._followed.pop(direction, None)
            self._contradictions[direction] = (
                f"the own link reads {direction} = {at_m * 1e3:.2f} mm on axis {report.axis}, the stage"
                f" reports {min(ends_m) * 1e3:.2f} to {max(ends_m) * 1e3:.2f} mm: the link leads to another"
                " controller; fix stop_link"
            )
            return
        self._contradictions.pop(direction, None)
        followed = self._followed.setdefault(direction, _Followed(at_m, at_m, report.answered_ns))
        followed.low_m, followed.high_m = min(followed.low_m, at_m), max(followed.high_m, at_m)
        followed.seen_ns = report.answered_ns
