"""All that the page of the rig shows, kept from messages: of a running graph or of a bag.

It reads what comes between two looks, so it costs the same however fast the graph goes; what was before the
first look it asks for once, on a thread.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from palp_core.graph.messages.topic import Topic
from palp_core.palpation.live_page.sweeps import (
    Band,
    Point,
    SweepTrace,
    TaughtSweeps,
    taught_by_folder,
    taught_by_messages,
    whole_sweep,
)
from palp_core.palpation.live_page.trials import TrialBelief, TrialBoard
from palp_core.palpation.mechanics.scene.scene import StagePath
from palp_core.view.source.overview import WireState
from palp_core.view.source.protocol import Sample, ViewSource, open_watches

RARE = (
    "PhantomTruth", "PrimitivesLearnt", "Trial", "TrialResult", "Belief", "ContactGuard",
    "RingState", "SweepStatus", "SweepGoal", "PolicyChange",
)  # fmt: skip
"""Every one counts; those of one time in this order."""
LATEST = (
    "Progress", "Outlook", "CoContraction", "EmgReport", "SafetyBeat", "StageReport", "RingReport", "Trip",
)  # fmt: skip
"""The last one counts."""


def topics_by_type(topics: Sequence[Topic], wires: Sequence[WireState] = ()) -> dict[str, str]:
    """Return the topic of each message type, whatever a launch file calls its nodes.

    Of several, as with a second estimator in shadow, that which the experiment reads; else one that is read.
    """
    experiment = next((topic.node for topic in topics if topic.type == "TrialResult"), "")
    by_experiment = {wire.topic for wire in wires if wire.reader == experiment}
    read_by_any = {wire.topic for wire in wires}
    found: dict[str, str] = {}
    for topic in sorted(topics, key=lambda one: (one.name not in by_experiment, one.name not in read_by_any)):
        found.setdefault(topic.type, topic.name)
    return found


def session_folder(source: ViewSource, topics: Mapping[str, str]) -> Path | None:
    """Return where a graph's record and report are written; None over a bag, and where it is unknown."""
    if source.overview().kind != "graph":
        return None
    launch = source.launch()
    out = launch.get("params", {}).get(node_of(topics.get("TrialResult", "")), {}).get("out")
    found = Path(launch.get("folder", ""), out) if isinstance(out, str) else Path()
    return found if found.is_absolute() else None


def path_of(launch: dict[str, Any]) -> tuple[float, float]:
    """Return where sweeps begin and end, by the launch file; the published path where it does not say."""
    path, given = StagePath(), dict[str, Any]()
    for params in launch.get("params", {}).values():
        given = params | given
    found = [
        float(value) if isinstance(value := given.get(name, usual), int | float) else usual
        for name, usual in (("from_m", path.from_m), ("to_m", path.to_m))
    ]
    return found[0], found[1]


def node_of(topic: str) -> str:
    return topic.partition("/")[2].partition("/")[0]


class RigMonitor:
    """The rig as one page sees it.

    With ``at_once``, of a graph in simulated time, a sweep is shown whole when it is over; with ``recorded``
    all is as it was at the chosen time of a bag.
    """

    def __init__(self, source: ViewSource, *, at_once: bool = False, recorded: bool = False) -> None:
        self._source, self.at_once, self._recorded = source, at_once, recorded
        self.topics = topics_by_type(source.topics(), source.overview().wires)
        streams = ("Palpation", "StagePose") if at_once else ("StagePose", "TorqueBlock", "Palpation")
        wanted = {self.topics[kind]: kind for kind in (*RARE, *LATEST, *streams) if kind in self.topics}
        self._watches = {wanted[name]: watch for name, watch in open_watches(source, wanted).items()}
        self.path_m = path_of(source.launch())
        self.taught = TaughtSweeps(*self.path_m)
        self._of_bag: list[tuple[str, Sample]] = []
        self._seen: dict[str, tuple[int, int]] = {}
        self._read: dict[str, Any] | None = None
        self.loaded = False
        self._forget()

    def _forget(self) -> None:
        self.sweep, self.belief, self.board = SweepTrace(), TrialBelief(), TrialBoard()
        self.ring: dict[str, Any] | None = None
        self.status: dict[str, Any] | None = None
        self.learnt: dict[str, Any] | None = None
        self.guards: list[str] | None = None
        self.mounted: dict[str, Any] | None = None
        self._place = 0
        self._at_ns = -1
        self._last_whole = -1

    def close(self) -> None:
        for watch in self._watches.values():
            watch.close()

    def has(self, kind: str) -> bool:
        return kind in self._watches

    def latest(self, kind: str) -> dict[str, Any] | None:
        """Return the last message of a type; None before the first, or where there is no such topic."""
        watch = self._watches.get(kind)
        sample = watch.latest() if watch is not None else None
        return sample.message if sample is not None and _whole(sample) else None

    def load(self) -> None:
        """Take what was before the first look. It asks and reads: call it once, on a thread."""
        types = {topic: name for name, topic in self.topics.items()}
        wanted = [self.topics[name] for name in RARE if name in self._watches]
        if not self._recorded:
            for name in RARE:
                if name in self._watches:
                    self._watches[name].read_new()  # from now on all is kept for the next look
        found = [(types[name], sample) for name, sample in self._source.history(wanted) if _whole(sample)]
        if self._recorded:
            self._of_bag = sorted(found, key=_order)
            self.taught = self._taught_by_bag()
        else:
            self._take_rare(found)
            self.load_taught()
        self.loaded = True

    @property
    def wants_taught(self) -> bool:
        """Whether training is over, and its sweeps are still to be read."""
        known = self.learnt is not None and session_folder(self._source, self.topics) is not None
        return known and self._read is not self.learnt

    def load_taught(self) -> None:
        """Take what training taught, by the session's folder, once training is over; on a thread."""
        out = session_folder(self._source, self.topics)
        if self.wants_taught and out is not None:
            self._read = self.learnt
            found = taught_by_folder(out, *self.path_m)
            self.taught = found if found.sweep_count else self.taught

    def _taught_by_bag(self) -> TaughtSweeps:
        known = [self.topics["Palpation"]] if "Palpation" in self._watches else []
        trials = [sample.message for name, sample in self._of_bag if name == "Trial"]
        palpations = (sample.message for _, sample in self._source.history(known))
        return taught_by_messages(trials, palpations, *self.path_m)

    def look(self) -> list[Point]:
        """Take what has come; return the new points of the sweep."""
        if not self.loaded:
            return []
        if self._recorded:
            self._go_to(self._source.overview().now_s or 0.0)
        else:
            self._take_rare(
                (name, sample)
                for name in RARE
                if name in self._watches
                for sample in self._watches[name].read_new()
                if _whole(sample)
            )
        if (outlook := self.latest("Outlook")) is not None:
            self.belief.look(outlook)
        return self._look_at_palpation() if self.at_once else self._look_at_streams()

    def _go_to(self, at_s: float) -> None:
        at_ns = round(at_s * 1e9)
        if at_ns < self._at_ns:
            self._forget()
        self._at_ns = at_ns
        while self._place < len(self._of_bag) and self._of_bag[self._place][1].stamp_ns <= at_ns:
            self._take(*self._of_bag[self._place])
            self._place += 1

    def _take_rare(self, messages: Iterable[tuple[str, Sample]]) -> None:
        for name, sample in sorted(messages, key=_order):
            place = sample.stamp_ns, sample.sequence
            if place > self._seen.get(name, (-1, 0)):  # what was asked for and what came overlap
                self._seen[name] = place
                self._take(name, sample)

    def _take(self, name: str, sample: Sample) -> None:
        message = sample.message
        match name:
            case "PhantomTruth":
                self.mounted = message
                self.board.mounted(sample.stamp_ns, message)
            case "PrimitivesLearnt":
                self.learnt = message
                self.board.learnt(message["depths_m"])
            case "Trial":
                self.belief.begin(message)
            case "TrialResult":
                self.board.result(sample.stamp_ns, message)
            case "Belief":
                self.belief.believe(message)
            case "PolicyChange":
                self.board.took_over(message)
            case "ContactGuard":
                self._note_guards(message["words"])
            case "RingState" if self._last_whole < 0:
                self.ring = message
            case "SweepStatus":
                self.status = message
            case "SweepGoal" if not message["cancel"]:
                self.path_m = message["from_m"], message["to_m"]

    def _note_guards(self, words: list[str]) -> None:
        self.guards = [*words, *(one for one in self.guards or () if one not in words)]

    def _look_at_palpation(self) -> list[Point]:
        pose = self.latest("StagePose")
        if pose is not None and pose["position_m"]:
            self.sweep.position_m = pose["position_m"][-1]
        watch = self._watches.get("Palpation")
        sample = watch.latest() if watch is not None else None
        if sample is None or sample.sequence == self._last_whole or not _whole(sample):
            return []
        self._last_whole = sample.sequence
        self.sweep.number += 1
        self.sweep.points = whole_sweep(sample.message["torque_n_m"], *self.path_m)
        ring_m = sample.message["ring_m"]  # as it was in that sweep: there are many between two looks
        self.ring = {"target_m": ring_m, "measured_m": ring_m, "settled": True, "rehome": False}
        return self.sweep.points

    def _look_at_streams(self) -> list[Point]:
        for name, take in (("StagePose", self.sweep.pose), ("TorqueBlock", self.sweep.torque)):
            watch = self._watches.get(name)
            for sample in watch.read_new() if watch is not None else ():
                if _whole(sample):
                    take(sample.message)
        return self.sweep.new_points()

    @property
    def ring_m(self) -> float | None:
        """Where the ring is asked to be; None before its first state."""
        return self.ring["target_m"] if self.ring is not None else None

    def bands(self, ring_m: float | None) -> list[Band]:
        return [] if ring_m is None else self.taught.bands(ring_m)

    @property
    def position_m(self) -> float | None:
        """Where the stage is, by its report where there is one; None before its first report."""
        report = self.latest("StageReport")
        return report["y_m"] if report is not None else self.sweep.position_m

    @property
    def depth_mm(self) -> float:
        """How deep the bead of the mounted phantom is; 0 where it has none, or is unknown."""
        return round(1e3 * self.mounted["depth_m"], 6) if self.mounted is not None else 0.0

    @property
    def sweeping(self) -> bool:
        return self.status is not None and self.status["status"] == "sweeping"


def _whole(sample: Sample) -> bool:
    return "(not shown)" not in sample.message


def _order(entry: tuple[str, Sample]) -> tuple[int, int]:
    return entry[1].stamp_ns, RARE.index(entry[0])
