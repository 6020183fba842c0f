"""Record a running graph on the wall clock: into a bag as it goes, or into memory until somebody asks."""

import contextlib
import json
from collections.abc import Callable
from pathlib import Path

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagError, GraphError
from palp_core.graph.bag.recorder import BagRecorder, RecordingSummary
from palp_core.graph.bag.selection import topic_selection
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.clock import monotonic_ns, unix_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.topic import Topic
from palp_core.graph.recording.live_feed import ANSWER_NS, LiveFeed
from palp_core.graph.recording.live_snapshot import LiveSnapshot
from palp_core.graph.recording.live_topics import ASK_S, is_order, live_topics
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT, attachments, launch_attachment
from palp_core.graph.recording.recorder_messages import RecordOptions

WAIT_MS = 50
ANSWER_S = 0.5
NOTE_WAITING_NS = 5_000_000_000
DRAIN_NS = 300_000_000
LONGEST_DRAIN_NS = 10_000_000_000
QUIET_TURNS = 4
"""On a busy host no time says that nothing comes: the thread that fetches it may have had no turn."""


class LiveRecorder:
    """Follows a graph and records it.

    Args:
        graph: The running graph.
        options: What and how.
        say: Takes what a person should know.

    Attributes:
        saved: Snapshots that were written.
        unmatched: Topics that were waited for, and of which no frame came.

    Raises:
        BagError: Nothing to record, a graph in simulated time, or the bag exists.
        GraphError: The launcher does not answer.
    """

    def __init__(self, graph: RunningGraph, options: RecordOptions, say: Callable[[str], None]) -> None:
        if graph.record.clock != "wall":
            raise BagError(
                f"graph '{graph.record.graph}' runs in simulated time: "
                "record it with palp launch FILE --record DIR"
            )
        self._options, self._say = options, say
        self._chosen = topic_selection(options.topics, options.regex, options.exclude_regex)
        self._known = live_topics(graph)
        unknown = [name for name in options.topics if name not in self._known]
        if unknown:
            graph.topic(unknown[0])  # says which name is near
        if not any(map(self._chosen, self._known)):
            raise BagError("no topic of the graph is chosen: name topics, or record all with -a")
        self._graph = graph
        self.saved: list[str] = []
        self.unmatched: list[str] = []
        topics = list(self._known.values())
        self._attached = self._attachments()
        sink: BagRecorder | LiveSnapshot
        if options.snapshot_s:
            sink = LiveSnapshot(round(options.snapshot_s * 1e9), topics)
        else:
            sink = self._bag(Path(options.out), from_start=options.from_start)
        self._sink = sink
        self._feed = LiveFeed(graph, sink, from_start=options.from_start, on_change=self._follow_changes)
        sink.missed = self._feed.ask

    @property
    def ended(self) -> bool:
        return self._feed.ended

    def await_topics(self, end_wanted: Callable[[], bool]) -> bool:
        """Listen until every topic has been heard; return whether that was so before the end was wanted.

        What a node consumes comes last: it begins with the node's state, and everything that the node takes
        up after that is in the bag.
        """
        chosen = {name: live for name, live in self._known.items() if self._chosen(name)}
        orders = {name: live for name, live in chosen.items() if is_order(name)}
        rest = {name: live for name, live in chosen.items() if name not in orders}
        self.unmatched = sorted(chosen)
        for part in (rest, orders):
            self._feed.follow(part)
            if not self._await_heard(end_wanted):
                return False
        self.unmatched = []
        kept = f"; the last {self._options.snapshot_s:g} s are kept" if self._options.snapshot_s else ""
        self._say(
            f"recording {counted(len(chosen), 'topic')} of '{self._graph.record.graph}' to "
            f"{self._options.out}{kept}"
        )
        return True

    def _await_heard(self, end_wanted: Callable[[], bool]) -> bool:
        begin_ns, is_noted = monotonic_ns(), False
        while self._feed.unmatched:
            self.turn()
            self.unmatched = [name for name in self.unmatched if not self._sink.has_heard(name)]
            if end_wanted() or self.ended:
                return False
            if not is_noted and monotonic_ns() - begin_ns > NOTE_WAITING_NS:
                is_noted = True
                names = ", ".join(sorted(name.decode() for name in self._feed.unmatched))
                self._say(f"not heard yet, recording what comes: {names}")
        return True

    def turn(self) -> None:
        """Take what comes, for a moment."""
        self._feed.receive(WAIT_MS)
        now_ns = monotonic_ns()
        self._sink.tick(now_ns)
        if self._feed.start_ns is None:
            self._feed.find_start()

    def run(self, end_wanted: Callable[[], bool]) -> None:
        """Record until the end is wanted or the graph has ended."""
        while not end_wanted() and not self.ended:
            self.turn()

    def save(self) -> str:
        """Snapshot mode: write what is kept into a bag of its own; return what to say."""
        if not isinstance(self._sink, LiveSnapshot):
            raise BagError("this recorder keeps nothing in memory: start it with --snapshot S")
        count = len(self.saved)
        out = Path(self._options.out + (f"-{count}" if count else ""))
        recorder = self._bag(out, from_start=False)
        self._sink.save(recorder)
        summary = recorder.close()
        self.saved.append(str(out))
        return f"{out}: {summary.text()}"

    def close(self, *, patient: bool) -> RecordingSummary:
        """Take what is still on its way, finish the bag, and return its account.

        Args:
            patient: The publishers have ended: wait until nothing more comes. Otherwise for a moment only, as
                more always will.
        """
        end_ns = monotonic_ns() + (LONGEST_DRAIN_NS if patient else DRAIN_NS)
        quiet_ns, quiet_turns, before = monotonic_ns(), 0, self._sink.taken
        while (now_ns := monotonic_ns()) < end_ns or self._feed.answered_since(now_ns - ANSWER_NS):
            if quiet_turns >= QUIET_TURNS and now_ns - quiet_ns > DRAIN_NS and not self._feed.asking:
                break
            self._feed.receive(WAIT_MS)
            self._sink.tick(now_ns)
            quiet_turns += 1
            if self._sink.taken != before:
                before, quiet_ns, quiet_turns = self._sink.taken, now_ns, 0
        summary = self._sink.close()
        self._feed.close()
        return summary

    def _bag(self, out: Path, *, from_start: bool) -> BagRecorder:
        options = self._options
        writer = BagWriter(
            out,
            compression=options.compression,
            max_bytes=options.max_bytes,
            max_duration_ns=round(options.max_duration_s * 1e9),
            custom={"start_unix_ns": str(unix_ns())},
        )
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
        answers = self._graph.ask_all("get_parameters", timeout_s=ASK_S) if self._graph.node_names else None
        params = {name: reply["parameters"] for name, reply in answers.replies.items()} if answers else {}
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
        """Keep what the graph has become by a swap."""
        with contextlib.suppress(GraphError):  # it is about to end: what was known stays
            now = launch_attachment(self._graph.ask("graph", "launch", timeout_s=ANSWER_S))
            if now != self._attached[LAUNCH_ATTACHMENT]:
                self._attached[LAUNCH_ATTACHMENT] = now
                if isinstance(self._sink, BagRecorder):
                    self._sink.attach(LAUNCH_ATTACHMENT, now)

    def _add(self, new: dict[str, Topic]) -> None:
        self._known |= new
        for live in new.values():
            self._sink.describe(live)
        chosen = {name: live for name, live in new.items() if self._chosen(name)}
        if chosen:
            self._feed.follow(chosen, new=True)
            self._say(f"also recording {', '.join(sorted(chosen))}")
