"""A bag as a source: the same pages over a recording, at a chosen time."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagDamaged, BagError, GraphError, PalpError
from palp_core.graph.bag.info import BagInfo, bag_info
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.troubles import ERROR, WARN, Trouble
from palp_core.graph.messages.message_text import decoded
from palp_core.graph.messages.topic import Topic
from palp_core.graph.problems import hint
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.view.source.overview import NodeState, Overview, WireState, actions_as_one
from palp_core.view.source.protocol import Sample, Watch

SPAN_NS = 60_000_000_000
"""So much before the chosen time is plotted."""
MOST = 20_000
FIRST_LOOK_NS = 1_000_000_000


class RecordedSource:
    """A bag, from ``start_s`` to ``end_s`` on the graph's clock."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with Bag(path) as bag:
            times = list(_times(bag))
            self._topics = {name: _with_node(topic) for name, topic in bag.topics().items()}
            attachments = bag.attachments()
            problems = bag.problems
        self.start_s = min((start for start, _ in times), default=0) / 1e9
        self.end_s = max((end for _, end in times), default=0) / 1e9
        self._at_s = self.end_s  # all is there then
        self._playing_since_ns: int | None = None
        self._lock = threading.Lock()
        self._open: Bag | None = None
        self._launch = _launch(attachments)
        self._overview = self._made([Trouble(str(path), ERROR, text) for text in problems])
        threading.Thread(target=self._examine, name="palp view: bag", daemon=True).start()

    def overview(self) -> Overview:
        """Return nodes and wires, and what is wrong with the bag as far as it has been read."""
        return msgspec.structs.replace(self._overview, now_s=self.at_s)

    def topics(self) -> list[Topic]:
        return list(self._topics.values())

    def watch(self, topic: str) -> Watch:
        if topic not in self._topics:
            raise BagError(f"{self.path} has no topic '{topic}'{hint(topic, self._topics)}")
        return RecordedWatch(self, self._topics[topic])

    def history(self, topics: Sequence[str]) -> Iterator[tuple[str, Sample]]:
        """Yield all messages of some topics, whatever the chosen time; up to where the bag is damaged."""
        wanted = [name for name in topics if name in self._topics]
        with contextlib.suppress(BagError), Bag(self.path) as bag:
            for message in bag.recorded(wanted, 0, round(self.end_s * 1e9) + 1) if wanted else ():
                name = message.stream.topic.name
                yield name, _sample(message, self._topics[name])

    def launch(self) -> dict[str, Any]:
        """Return the launch file; {} if the bag has none."""
        return self._launch

    @property
    def at_s(self) -> float:
        """The chosen time, which goes on while it plays; all that is shown is from then or before."""
        since_ns = self._playing_since_ns
        at_s = self._at_s if since_ns is None else self._at_s + (monotonic_ns() - since_ns) / 1e9
        if at_s >= self.end_s:
            self._at_s, self._playing_since_ns = self.end_s, None
        return min(at_s, self.end_s)

    @property
    def playing(self) -> bool:
        """Whether the chosen time goes on as the machine's clock does, up to the end."""
        return self.at_s < self.end_s and self._playing_since_ns is not None

    def play(self, *, on: bool = True) -> None:
        """Let the time go on, from the end over to the begin; or let it stand."""
        at_s = self.at_s
        self._at_s = self.start_s if on and at_s >= self.end_s else at_s
        self._playing_since_ns = monotonic_ns() if on else None

    def seek(self, at_s: float) -> None:
        """Choose a time; one before or after the bag is its begin or end. What plays goes on from there."""
        playing, self._at_s = self.playing, min(max(at_s, self.start_s), self.end_s)
        self._playing_since_ns = monotonic_ns() if playing else None

    def between(self, topic: str, begin_ns: int, end_ns: int) -> list[RecordedMessage]:
        """Return the messages of a topic from one time to another, both among them.

        The bag stays open from the first call on: to open it takes longer than to read what a page shows.
        """
        found = []
        with self._lock, contextlib.suppress(BagError):
            self._open = self._open or Bag(self.path)
            for message in self._open.recorded([topic], max(begin_ns, 0), end_ns + 1):
                found.append(message)  # noqa: PERF402 - messages before a damaged part count; the strip reports the damage
        return found

    def close(self) -> None:
        with self._lock:
            if self._open is not None:
                self._open.close()
            self._open = None

    def _examine(self) -> None:
        try:
            troubles = bag_troubles(bag_info(self.path))
        except PalpError as error:
            troubles = [Trouble(str(self.path), ERROR, str(error))]
        self._overview = self._made(troubles)

    def _made(self, troubles: list[Trouble]) -> Overview:
        launch = self._launch
        listens: dict[str, list[str]] = launch.get("listens", {})
        names = list(launch.get("publishes", ())) or sorted({topic.node for topic in self._topics.values()})
        wires = [
            WireState(topic=topic, source=topic.split("/")[1], reader=reader)
            for reader, topics in listens.items()
            for topic in topics
        ]
        return Overview(
            kind="bag",
            title=str(launch.get("graph", self.path.name)),
            run=self.path.name,
            clock=str(launch.get("clock", "")),
            now_s=self.at_s,
            alive=False,
            nodes=[NodeState(name=name) for name in names],
            wires=actions_as_one(wires),
            troubles=troubles,
        )


class RecordedWatch:
    """A topic of a bag, as it was at the chosen time."""

    def __init__(self, source: RecordedSource, topic: Topic) -> None:
        self._source, self.topic = source, topic
        self._shown_ns: int | None = None
        self._read_ns: int | None = None
        self._latest: Sample | None = None
        self._rate_hz: float | None = None

    def latest(self) -> Sample | None:
        """Return the last message before the chosen time; None before the first."""
        at_ns = round(self._source.at_s * 1e9)
        if at_ns != self._shown_ns:
            self._shown_ns = at_ns
            self._latest = self._find(at_ns)
        return self._latest

    def read_new(self) -> list[Sample]:
        """Return what is new since the call before, up to the chosen time: a minute of it at most."""
        at_ns = round(self._source.at_s * 1e9)
        before_ns = self._read_ns
        if at_ns == before_ns:
            return []
        self._read_ns = at_ns
        goes_on = before_ns is not None and before_ns < at_ns < before_ns + SPAN_NS
        begin_ns = before_ns + 1 if goes_on and before_ns is not None else at_ns - SPAN_NS
        return [_sample(message, self.topic) for message in self._between(begin_ns, at_ns)[-MOST:]]

    @property
    def rate_hz(self) -> float | None:
        """Messages a second before the chosen time; None where there are fewer than two."""
        return self._rate_hz

    def close(self) -> None:
        """Stop watching."""

    def _find(self, at_ns: int) -> Sample | None:
        """Look back from the chosen time, further each time, until there is something."""
        span_ns, begin_ns = FIRST_LOOK_NS, round(self._source.start_s * 1e9)
        while True:
            found = self._between(at_ns - span_ns, at_ns)
            if len(found) > 1 and (took_ns := found[-1].publish_ns - found[0].publish_ns) > 0:
                self._rate_hz = (len(found) - 1) * 1e9 / took_ns
            if found:
                return _sample(found[-1], self.topic)
            if at_ns - span_ns < begin_ns:
                return None
            span_ns *= 4

    def _between(self, begin_ns: int, end_ns: int) -> list[RecordedMessage]:
        return self._source.between(self.topic.name, begin_ns, end_ns)


def _sample(message: RecordedMessage, topic: Topic) -> Sample:
    try:
        plain = decoded(message.payload, topic.json_schema)
    except GraphError as error:
        plain = {"(not shown)": str(error)}
    return Sample(message.publish_ns, message.sequence, plain)


def bag_troubles(info: BagInfo) -> list[Trouble]:
    """Return what is wrong with a bag: damage first, then gaps."""
    found = [
        Trouble(info.path, ERROR, text, f"palp bag recover {info.path} -o NEW") for text in info.problems
    ]
    for name, topic in info.topics.items():
        if topic.lost:
            gaps = ", ".join(f"{gap.first} to {gap.last}" for gap in topic.gaps[:5])
            missing = counted(topic.lost, "message is", "messages are")
            found.append(Trouble(name, WARN, f"{missing} missing ({gaps})", f"palp bag info {info.path}"))
        if topic.backward_count:
            times = counted(topic.backward_count, "time")
            text = f"its clock goes back {times}, by {topic.backward_s:.6g} s at most"
            found.append(Trouble(name, WARN, text, f"palp bag info {info.path}"))
    return found


def _times(bag: Bag) -> Iterator[tuple[int, int]]:
    """Yield begin and end of each chunk; of a file that was cut off, of those that are whole."""
    for file in bag.files:
        for place in file.chunks:
            if place.entry is not None:
                yield place.entry.message_start_time, place.entry.message_end_time
                continue
            with contextlib.suppress(BagDamaged):
                stamps = [message[2] for message in file.read_chunk(place)]
                if stamps:
                    yield min(stamps), max(stamps)


def _with_node(topic: Topic) -> Topic:
    return topic if topic.node else msgspec.structs.replace(topic, node=topic.name.split("/")[1])


def _launch(attachments: dict[str, bytes]) -> dict[str, Any]:
    try:
        return msgspec.json.decode(attachments[LAUNCH_ATTACHMENT], type=dict[str, Any])
    except (KeyError, msgspec.MsgspecError):
        return {}
