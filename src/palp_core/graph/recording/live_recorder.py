"""Record a running graph on the wall clock: into a bag as it goes, or into memory until somebody asks."""

import contextlib
import json
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagError, GraphError, SchemaMismatch
from palp_core.graph.bag.recorder import BagRecorder, RecordingSummary
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.graph_reader import KIND_OFFSET
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.troubles import ERROR, OK, level_of
from palp_core.graph.messages.builtin import DiagnosticStatus, GraphEvent
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import Topic
from palp_core.graph.recording.live_feed import (
    ANSWER_NS,
    ASK_S,
    LiveFeed,
    is_order,
    live_topics,
    recorded_nodes,
)
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT, attachments, launch_attachment
from palp_core.graph.recording.recorder_params import RecorderParams, cannot_write, snapshot_name

AFTERMATH_NS = 1_000_000_000
"""How long after a trouble its snapshot is written, so that what followed is in it, too."""
WAIT_MS = 50
ANSWER_S = 0.5
NOTE_WAITING_NS = 5_000_000_000
DRAIN_NS = 300_000_000
LONGEST_DRAIN_NS = 10_000_000_000
QUIET_TURNS = 4
"""On a busy host no time shows that nothing comes: the thread that fetches it may have had no turn."""


class LiveRecorder:
    """Records what its ``feed`` receives.

    ``from_start``: it begins with the graph, whose start is to be given to the feed.
    """

    def __init__(
        self, graph: RunningGraph, params: RecorderParams, note: Callable[[str], None], *, from_start: bool
    ) -> None:
        if graph.record.clock != "wall":
            raise BagError(
                f"graph '{graph.record.graph}' runs in simulated time: "
                "record it with palp launch FILE --record DIR"
            )
        self._params, self._note = params, note
        self._out = Path(params.out).absolute()
        self._chosen = params.selection()
        self._known = live_topics(graph)
        for name in params.names:
            if name not in self._known:
                graph.topic(name)  # raises, with the name that is near
        if not any(map(self._chosen, self._known)):
            raise BagError("no topic of the graph is chosen: name topics, or record all with -a")
        self._graph, self._from_start = graph, from_start
        self._saved_count, self._closed = 0, False
        topics = list(self._known.values())
        self._attached = self._attachments()
        self._sink = (
            SnapshotRecorder(round(params.snapshot_s * 1e9), topics, watch=params.snapshot_on_trouble)
            if params.snapshot_s
            else self._bag(self._out, from_start=from_start)
        )
        self.feed = LiveFeed(graph, self._sink, from_start=from_start, on_change=self._follow_changes)
        self._sink.missed = self.feed.ask

    def await_topics(self, end_wanted: Callable[[], bool]) -> None:
        """Receive until a frame of every topic has come, or the end is wanted.

        The order of what a node consumes comes last: it begins with the node's state, and everything that the
        node takes up after that is in the bag.
        """
        chosen = {name: topic for name, topic in self._known.items() if self._chosen(name)}
        orders = {name: topic for name, topic in chosen.items() if is_order(name)}
        rest = {name: topic for name, topic in chosen.items() if name not in orders}
        begin_ns, is_noted = monotonic_ns(), False
        for part in (rest, orders):
            self.feed.follow(part)
            while self.feed.unmatched and not (end_wanted() or self.feed.ended):
                self.turn()
                if not is_noted and monotonic_ns() - begin_ns > NOTE_WAITING_NS:
                    is_noted = True
                    names = ", ".join(sorted(name.decode() for name in self.feed.unmatched))
                    self._note(f"no message yet, recording what comes: {names}")
        if not self.feed.unmatched:
            kept = f"; the last {self._params.snapshot_s:g} s are kept" if self._params.snapshot_s else ""
            count = counted(len(chosen), "topic")
            self._note(f"recording {count} of '{self._graph.record.graph}' to {self._out}{kept}")

    def turn(self, wait_ms: int = WAIT_MS) -> bool:
        """Take what comes, for a moment; return whether there may be more."""
        with self._writing():
            more = self.feed.receive(wait_ms)
            self._sink.tick(monotonic_ns())
        if self.feed.start_ns is None and not self._from_start:
            self.feed.find_start()
        return more

    def save(self) -> str:
        """Write the messages that are kept in memory into a bag of their own; return the account."""
        if not isinstance(self._sink, SnapshotRecorder):
            raise BagError("this recorder keeps nothing in memory: start it with --snapshot S")
        end_ns = monotonic_ns() + DRAIN_NS
        while not self._closed and self.turn(wait_ms=0) and monotonic_ns() < end_ns:
            pass  # what has arrived by now is part of the last seconds
        out = Path(snapshot_name(str(self._out), self._saved_count))
        recorder = self._bag(out, from_start=False)
        self._sink.save(recorder)
        summary = recorder.close()
        self._saved_count += 1
        return f"{out}: {summary.text()}"

    def save_trouble(self, *, at_once: bool = False) -> str:
        """Write what is kept if a trouble has been seen a while ago; return what happened and the account."""
        sink = self._sink
        if not isinstance(sink, SnapshotRecorder) or not sink.trouble:
            return ""
        if not at_once and monotonic_ns() < sink.trouble_ns + AFTERMATH_NS:
            return ""
        trouble, sink.trouble = sink.trouble, ""
        return f"{trouble}; the last {self._params.snapshot_s:g} s are in {self.save()}"

    def abandon(self) -> None:
        self._sink.abandon()
        self.feed.close()

    def close(self, *, patient: bool) -> RecordingSummary:
        """Take what is still on its way, finish the bag, and return its account.

        ``patient``: the publishers have ended; wait until nothing more comes.
        """
        end_ns = monotonic_ns() + (LONGEST_DRAIN_NS if patient else DRAIN_NS)
        quiet_ns, quiet_turns, before = monotonic_ns(), 0, self._sink.taken
        with self._writing():
            while (now_ns := monotonic_ns()) < end_ns or self.feed.answered_since(now_ns - ANSWER_NS):
                if quiet_turns >= QUIET_TURNS and now_ns - quiet_ns > DRAIN_NS and not self.feed.asking:
                    break
                self.feed.receive(WAIT_MS)
                self._sink.tick(now_ns)
                quiet_turns += 1
                if self._sink.taken != before:
                    before, quiet_ns, quiet_turns = self._sink.taken, now_ns, 0
            self._sink.silent = sorted(name.decode() for name in self.feed.unmatched)
            summary = self._sink.close()
        self.feed.close()
        self._closed = True
        return summary

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise BagError(cannot_write(self._out, error)) from error

    def _bag(self, out: Path, *, from_start: bool) -> BagRecorder:
        writer = self._params.new_writer(out)
        record = self._graph.record
        run = {
            "graph": record.graph,
            "file": record.file,
            "clock": record.clock,
            "run": self._graph.folder.name,
        }
        writer.add_metadata("palp", {**run, "run_start_unix_ns": str(record.start_unix_ns)})
        topics = list(self._known.values())
        return BagRecorder(writer, topics, from_start=from_start, attachments=self._attached)

    def _attachments(self) -> dict[str, bytes]:
        provenance = self._graph.ask("graph", "launch")
        nodes = recorded_nodes(self._graph)
        replies = self._graph.ask_all("get_parameters", nodes, timeout_s=ASK_S).replies
        params = {name: reply["parameters"] for name, reply in replies.items()}
        return {
            **attachments(provenance, params),
            "palp/run.json": json.dumps(msgspec.to_builtins(self._graph.record), indent=1).encode(),
        }

    def _follow_changes(self) -> None:
        """Record what a node that joined publishes, and what a swap made of the graph."""
        self._keep_launch()
        known = {entry.name for entry in self._graph.record.topics}
        if not known <= self._known.keys():
            self._add({n: live for n, live in live_topics(self._graph).items() if n not in self._known})

    def _keep_launch(self) -> None:
        with contextlib.suppress(GraphError):  # it is about to end: what was known stays
            now = launch_attachment(self._graph.ask("graph", "launch", timeout_s=ANSWER_S))
            if now != self._attached[LAUNCH_ATTACHMENT]:
                self._attached[LAUNCH_ATTACHMENT] = now
                self._sink.attach(LAUNCH_ATTACHMENT, now)

    def _add(self, new: dict[str, Topic]) -> None:
        self._known |= new
        for live in new.values():
            self._sink.describe(live)
        chosen = {name: live for name, live in new.items() if self._chosen(name)}
        if chosen:
            self.feed.follow(chosen, new=True)
            self._note(f"also recording {', '.join(sorted(chosen))}")


class SnapshotRecorder(BagRecorder):
    """Accounts for every frame, and keeps it for a while; the last message of a latched topic for good.

    With ``watch`` it notes the first trouble that nodes or launcher report.
    """

    def __init__(self, duration_ns: int, topics: Iterable[Topic], *, watch: bool = False) -> None:
        writer: Any = _NoBag()
        topics = list(topics)
        super().__init__(writer, topics, from_start=False)
        self._duration_ns = duration_ns
        self._frames: deque[tuple[int, bytes]] = deque()
        self._latched_topics = frozenset(topic.name.encode() for topic in topics if topic.latched_depth)
        self._watch = watch
        self._latched: dict[bytes, tuple[int, bytes]] = {}
        self.trouble, self.trouble_ns = "", 0  # the first since the last snapshot; when it was seen

    def describe(self, topic: Topic) -> None:
        super().describe(topic)
        if topic.latched_depth:
            self._latched_topics |= {topic.name.encode()}

    def expect_from(self, topic: str, epoch: int, first: int) -> None:
        """Nothing is expected of what was before."""

    def __call__(self, now_ns: int, frame: bytes) -> None:
        """Keep a frame and forget those that are too old."""
        super().__call__(now_ns, frame)
        kind = frame.find(0) + KIND_OFFSET
        if kind < len(frame) and frame[kind] == Kind.DATA:
            self._frames.append((now_ns, frame))
            if self._watch and not self.trouble:
                self._look_for_trouble(frame)
        while self._frames and self._frames[0][0] < now_ns - self._duration_ns:
            old = self._frames.popleft()
            topic = old[1].partition(b"\0")[0]
            if topic in self._latched_topics:
                self._latched[topic] = old

    def _look_for_trouble(self, raw: bytes) -> None:
        """Note a status that is an error, and the launcher's bad news."""
        try:
            frame = parse(raw)
            if frame.type_hash not in _REPORTS:
                return
            report = decode(_REPORTS[frame.type_hash], frame.payload)
        except SchemaMismatch:
            return
        level = level_of(report)
        if level == ERROR or (level != OK and isinstance(report, GraphEvent)):
            node = report.node if isinstance(report, GraphEvent) else frame.topic.split("/")[1]
            self.trouble, self.trouble_ns = f"/{node}: {report.text}", monotonic_ns()

    def save(self, recorder: BagRecorder) -> None:
        """Give the frames to a recorder that does not expect sequence 1, the latched values first."""
        for now_ns, frame in [*sorted(self._latched.values()), *self._frames]:
            recorder(now_ns, frame)


_REPORTS: dict[int, type[DiagnosticStatus | GraphEvent]] = {
    schema_of(kind).type_hash: kind for kind in (DiagnosticStatus, GraphEvent)
}


class _NoBag:
    """In a writer's place: nothing is written yet."""

    deleted: Mapping[str, int] = Counter()

    def stream(self, *_: object) -> int:
        return 0

    def ignore(self, *_: object, **__: object) -> None:
        pass

    write = tick = attach = close = abandon = ignore
