"""What nodes and launcher report of a run that its summary keeps: incidents, methods used, changes."""

import json
from bisect import insort
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any

import msgspec

from palp_core.graph.clock import unix_ns
from palp_core.graph.messages.builtin import DiagnosticStatus, MethodsUsed, MethodUse
from palp_core.graph.node.spec import GRAPH_EVENTS, LAUNCHER


class Incident(msgspec.Struct, frozen=True, kw_only=True):
    """What a node reported as not ``ok``.

    Attributes:
        at: Time of day; on the graph's clock where that is not known.
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


class MethodSpan(msgspec.Struct, frozen=True, kw_only=True):
    """A method, and how long a node used it."""

    node: str
    at_s: float
    until_s: float | None = None  # None: until the end
    use: MethodUse


class RunChange(msgspec.Struct, frozen=True):
    """Another class took a node's place, or parameters were set."""

    node: str
    at_s: float
    before: str = ""  # its class until then; "" where only parameters were set
    run: str = ""
    params: dict[str, Any] = {}


class JournalEntries(msgspec.Struct, kw_only=True):
    """What a journal holds."""

    incidents: list[Incident] = []
    standing: dict[str, int] = {}  # by topic, the place among these of each that is not over
    methods: list[MethodSpan] = []
    changes: list[RunChange] = []


class RunJournal:
    """Collects what is reported of a run.

    Attributes:
        on_incident: Called with the topic that reports a change, and the incident; None: it is over.
    """

    def __init__(self) -> None:
        self.entries = JournalEntries()
        self.on_incident: Callable[[str, Incident | None], None] = lambda *_: None

    def restore(self, entries: JournalEntries) -> None:
        self.entries = entries
        for name, place in entries.standing.items():
            self.on_incident(name, entries.incidents[place])

    def observe_status(self, now_ns: int, name: str, status: DiagnosticStatus) -> None:
        """Take a node's status as it comes, at a time on the graph's clock."""
        self.add_status(name, name.split("/")[1], status, time_of_day(max(now_ns - status.stamp_ns, 0)))

    def observe_methods(self, _: int, name: str, used: MethodsUsed) -> None:
        self.add_methods(name.split("/")[1], used)

    def observe_event(self, _: int, name: str, event: Any) -> None:
        self.add_event(name, event)

    def add_own(self, text: str, advice: str, now_ns: int) -> None:
        """Add what the launcher itself finds wrong, at a time on the graph's clock; "" once it is over."""
        level = "warn" if text else "ok"
        status = DiagnosticStatus(stamp_ns=now_ns, level=level, text=text, advice=advice)
        self.add_status(f"/{LAUNCHER}/diagnostics", LAUNCHER, status, time_of_day(0))

    def add_status(self, name: str, node: str, status: DiagnosticStatus, at: str) -> None:
        incidents, standing = self.entries.incidents, self.entries.standing
        place = standing.get(name)
        before = None if place is None else incidents[place]
        if before is not None and (before.level, before.text) == (status.level, status.text):
            return  # reported again, by a successor
        if before is None and status.level == "ok":
            return
        at_s = status.stamp_ns / 1e9
        if place is not None and before is not None:
            incidents[place] = msgspec.structs.replace(before, until_s=at_s)
            del standing[name]
        incident = None
        if status.level != "ok":
            incident = Incident(
                node=node, level=status.level, text=status.text, advice=status.advice, at=at, at_s=at_s
            )
            standing[name] = len(incidents)
            incidents.append(incident)
        self.on_incident(name, incident)

    def add_methods(self, node: str, used: MethodsUsed) -> None:
        methods, at_s = self.entries.methods, used.stamp_ns / 1e9
        named = {(use.task, use.of): use for use in used.uses}
        for place, span in enumerate(methods):
            if span.node != node or span.until_s is not None:
                continue
            if named.get((span.use.task, span.use.of)) == span.use:
                del named[span.use.task, span.use.of]
            else:
                methods[place] = msgspec.structs.replace(span, until_s=at_s)
        methods += [MethodSpan(node=node, at_s=at_s, use=use) for use in named.values()]

    def add_event(self, name: str, event: Any) -> None:
        """Add what an event on a topic reports, if it is a change.

        Each goes to its place in time: a swap is reported after its probation, when more may have been set.
        """
        if name == GRAPH_EVENTS and event.kind == "swapped":
            found = json.loads(event.data)
            given, classes = found.get("given", {}), (found["before"], found["after"])
            change = RunChange(found["node"], found["at_s"], *classes, params=given)
        elif name != GRAPH_EVENTS and event.kind == "parameters":
            given = {key: after for key, (_, after) in json.loads(event.data).items()}
            change = RunChange(name.split("/")[1], event.stamp_ns / 1e9, params=given)
        else:
            return
        insort(self.entries.changes, change, key=lambda entry: entry.at_s)


def last_set(changes: Sequence[RunChange], node: str) -> dict[str, Any]:
    """Return what was set of a node's parameters since its class took its place, by name."""
    found: dict[str, Any] = {}
    for change in changes:
        if change.node == node:
            found = {} if change.run != change.before else found
            found |= change.params
    return found


def time_of_day(age_ns: int) -> str:
    """Return the time of day that was so long ago."""
    return datetime.fromtimestamp((unix_ns() - age_ns) / 1e9).astimezone().strftime("%H:%M:%S")
