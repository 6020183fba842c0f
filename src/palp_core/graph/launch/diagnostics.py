"""What the nodes of a run say of how they stand, and what of it a person is to see."""

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime

import msgspec

from palp_core.graph.clock import unix_ns
from palp_core.graph.messages.builtin import DiagnosticStatus
from palp_core.graph.node.spec import LAUNCHER


class Incident(msgspec.Struct, frozen=True, kw_only=True):
    """What a node said was not ``ok``.

    Attributes:
        node: Who said it.
        level: ``warn`` or ``error``.
        text: What was wrong.
        advice: What to do about it.
        at: Time of day; on the graph's clock where that is not known.
        at_s: When, on the graph's clock.
        until_s: When it was over; None if it never was.
    """

    node: str
    level: str
    text: str
    advice: str
    at: str
    at_s: float
    until_s: float | None = None

    def __str__(self) -> str:
        end = "until the end" if self.until_s is None else f"for {self.until_s - self.at_s:.1f} s"
        return f"{self.at} /{self.node}: {self.text} ({end})"


class Diagnostics:
    """Collects the incidents of a run from its nodes' :class:`DiagnosticStatus` messages.

    Attributes:
        incidents: In the order in which they began.
        on_change: Is told which topic says otherwise than before, and the incident; None if it is over.
    """

    def __init__(self) -> None:
        self.incidents: list[Incident] = []
        self.on_change: Callable[[str, Incident | None], None] = lambda *_: None
        self._standing: dict[str, int] = {}

    @property
    def standing(self) -> dict[str, int]:
        """The place among the incidents of each that is not over, by topic."""
        return dict(self._standing)

    def restore(self, incidents: Sequence[Incident], standing: Mapping[str, int]) -> None:
        """Know what was said before an interruption."""
        self.incidents, self._standing = list(incidents), dict(standing)
        for topic, place in standing.items():
            self.on_change(topic, self.incidents[place])

    def observe(self, now_ns: int, topic: str, status: DiagnosticStatus) -> None:
        """Take what a node reports, which comes at this time on the graph's clock."""
        self.note(topic, topic.split("/")[1], status, time_of_day(max(now_ns - status.stamp_ns, 0)))

    def tell(self, text: str, advice: str, now_ns: int) -> None:
        """Note what the launcher itself finds wrong, at a time on the graph's clock; "" once it is over."""
        level = "warn" if text else "ok"
        status = DiagnosticStatus(stamp_ns=now_ns, level=level, text=text, advice=advice)
        self.note(f"/{LAUNCHER}/diagnostics", LAUNCHER, status, time_of_day(0))

    def note(self, topic: str, node: str, status: DiagnosticStatus, at: str) -> None:
        """Note what a node said on a topic, and when."""
        now = self._standing.get(topic)
        before = None if now is None else self.incidents[now]
        if before is not None and before.level == status.level and before.text == status.text:
            return  # said again, by a successor
        if before is None and status.level == "ok":
            return
        if now is not None and before is not None:
            self.incidents[now] = msgspec.structs.replace(before, until_s=status.stamp_ns / 1e9)
            del self._standing[topic]
        if status.level != "ok":
            self._standing[topic] = len(self.incidents)
            self.incidents.append(_incident(node, status, at))
        self.on_change(topic, self.incidents[-1] if status.level != "ok" else None)


def _incident(node: str, status: DiagnosticStatus, at: str) -> Incident:
    return Incident(
        node=node,
        level=status.level,
        text=status.text,
        advice=status.advice,
        at=at,
        at_s=status.stamp_ns / 1e9,
    )


def time_of_day(age_ns: int) -> str:
    """Return the time of day that was so long ago."""
    return datetime.fromtimestamp((unix_ns() - age_ns) / 1e9).astimezone().strftime("%H:%M:%S")
