"""The recorders of a graph as its launcher sees them: of ``palp launch --record`` and of the launch file.

On the wall clock each is a node in a process of its own. In lockstep the launcher writes the bags, as every
message passes through it.
"""

from __future__ import annotations

import itertools
import logging
import os
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import BagError, NodeError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.recorder import SUMMARY_NAME, BagRecorder, RecordingSummary
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.node.spec import RECORDER, NodeSpec
from palp_core.graph.recording.provenance import (
    LAUNCH_ATTACHMENT,
    attachments,
    launch_attachment,
    launch_provenance,
)
from palp_core.graph.recording.recorder_params import RecorderParams, cannot_write, snapshot_name
from palp_core.graph.supervision.launcher_node import LauncherNode

DEFAULT_NAME = "recorder"
TICK_FRAMES = 64
_LOG = logging.getLogger("palp.supervisor")


class Recorders:
    """Every recorder of one graph; ``out`` is a bag for all of it, besides what the launch file has.

    Of a ``resumed`` run each recorder begins another bag next to its first, ``bag_2`` next to ``bag``.
    """

    def __init__(
        self, graph: CheckedGraph | None = None, out: Path | None = None, *, resumed: bool = False
    ) -> None:
        self.nodes: list[NodeSpec] = []  # on the wall clock, the graph's nodes with its recorders
        self.launcher_node: LauncherNode | None = None
        self._results: list[tuple[bool, str]] = []
        self._writers: list[LockstepRecorder] = []
        self._bags: list[str] = []
        self._snapshots: list[str] = []
        if graph is None:
            return
        wanted = [spec for spec in (*graph.nodes, *graph.recorders) if spec.run == RECORDER]
        found = {spec.name: _prepared(spec, resumed=resumed) for spec in wanted}
        if out is not None:
            taken = {spec.name for spec in graph.nodes} | found.keys()
            spec = NodeSpec(name=_free_name(taken), run=RECORDER, params={"out": str(out)}, seed=graph.seed)
            found[spec.name] = _prepared(spec)
        self.nodes = [spec for spec in graph.nodes if spec.run != RECORDER]
        if graph.clock == "sim":
            self._writers = [LockstepRecorder(spec, graph) for spec in found.values()]
            return
        self.nodes += found.values()
        for spec in found.values():
            bags = self._snapshots if spec.params.get("snapshot_s") else self._bags
            bags.append(spec.params["out"])

    def observe(self, now_ns: int, frame: bytes) -> None:
        for writer in self._writers:
            try:
                writer(now_ns, frame)
            except OSError as error:
                self._lose(writer, error)

    def follow(self, graph: CheckedGraph) -> None:
        """Simulated clock: keep what the graph has become by a swap; other recorders ask for it."""
        for writer in self._writers:
            try:
                writer.follow(graph)
            except OSError as error:
                self._lose(writer, error)

    def _lose(self, writer: LockstepRecorder, error: OSError) -> None:
        """Go on without a bag that cannot be written any more, and report it."""
        self._writers = [other for other in self._writers if other is not writer]
        text = writer.fail(error)
        self._results.append((False, text))
        if self.launcher_node is not None:
            self.launcher_node.report("recorder", writer.name, text)
        _LOG.warning("%s: %s", writer.name, text)
        if writer.required:
            raise NodeError(writer.name, text)

    def close(self) -> None:
        """Close the launcher's bags, and look what became of the others."""
        self._results += [writer.close() for writer in self._writers]
        self._results += [_result_of(bag) for bag in self._bags]
        for out in self._snapshots:
            written = itertools.takewhile(os.path.exists, (snapshot_name(out, n) for n in itertools.count()))
            found = [_result_of(bag) for bag in written]
            self._results += found or [(True, f"{out}: no snapshot was asked for")]
        self._writers, self._bags, self._snapshots = [], [], []

    @property
    def in_launcher(self) -> bool:
        """Whether the launcher itself writes a bag."""
        return bool(self._writers)

    @property
    def complete(self) -> bool:
        """Nothing is missing in any of the bags."""
        return all(complete for complete, _ in self._results)

    @property
    def text(self) -> str:
        return "\n".join(text for _, text in self._results)


class LockstepRecorder:
    """Observes a lockstep graph and writes its bag."""

    def __init__(self, spec: NodeSpec, graph: CheckedGraph) -> None:
        params = msgspec.convert(spec.params, RecorderParams)
        if params.snapshot_s:
            raise BagError(f"{graph.file}: a recorder keeps the last seconds on the wall clock only")
        topics = [info.as_topic(name) for name, info in graph.topics.items()]
        writer, select = params.new_writer(params.out), params.selection()
        attached = attachments(launch_provenance(graph))
        try:
            self._recorder = BagRecorder(writer, topics, select=select, attachments=attached)
        except OSError as error:
            writer.abandon()
            raise BagError(f"{params.out} cannot be written: {error.strerror}") from error
        self.name, self.required, self._out = spec.name, params.required, params.out
        self._count = 0

    def __call__(self, now_ns: int, frame: bytes) -> None:
        self._recorder(now_ns, frame)
        self._count += 1
        if self._count % TICK_FRAMES == 0:
            self._recorder.tick(monotonic_ns())

    def follow(self, graph: CheckedGraph) -> None:
        """Keep what the graph has become by a swap."""
        self._recorder.attach(LAUNCH_ATTACHMENT, launch_attachment(launch_provenance(graph)))

    def close(self) -> tuple[bool, str]:
        """Close the bag; return whether nothing is missing, and the account."""
        try:
            summary = self._recorder.close()
        except OSError as error:
            return False, self.fail(error)
        return summary.complete, f"{self._out}: {summary.text()}"

    def fail(self, error: OSError) -> str:
        self._recorder.abandon()
        return cannot_write(self._out, error)


def _prepared(spec: NodeSpec, *, resumed: bool = False) -> NodeSpec:
    """Return a recorder with the bag that it is to write."""
    out = str(Path(spec.params["out"]).absolute())
    names = itertools.chain([out], (f"{out}_{number}" for number in itertools.count(2)))
    out = next(name for name in names if not (resumed and Path(name).exists()))
    if Path(out).exists():
        raise BagError(f"{out} exists already: choose another name")
    params: dict[str, Any] = {**spec.params, "out": out}
    return msgspec.structs.replace(spec, params=params)


def _free_name(taken: set[str]) -> str:
    names = itertools.chain([DEFAULT_NAME], (f"{DEFAULT_NAME}_{number}" for number in itertools.count(2)))
    return next(name for name in names if name not in taken)


def _result_of(bag: str) -> tuple[bool, str]:
    """Return whether nothing is missing in a recorder's bag, and the account."""
    try:
        with Bag(bag) as opened:
            summary = msgspec.json.decode(opened.attachments()[SUMMARY_NAME], type=RecordingSummary)
    except (BagError, KeyError, msgspec.MsgspecError):
        return False, f"{bag}: its recorder has not finished it; save it: palp bag recover {bag} -o NEW"
    return summary.complete, f"{bag}: {summary.text()}"
