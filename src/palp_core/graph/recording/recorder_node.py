"""A recorder as a node: it records the graph that it is in, from a process of its own.

It receives every topic before the first other node is active, so that each first message is in the bag, and
is shut down when all others are. In lockstep the launcher records instead (:mod:`.recorders`).
"""

from pathlib import Path

from palp_core.errors import BagError, GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import read_record
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import DiagnosticStatus
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.node import Node
from palp_core.graph.node.ports import Alarm, Pub, Srv, on, serve
from palp_core.graph.recording.live_recorder import LiveRecorder
from palp_core.graph.recording.recorder_params import RecorderParams

GATHER_NS = 5_000_000
"""How much later than it arrives a message may be logged: as long as others are gathered."""
LONGEST_WAIT_NS = 90_000_000
"""Between two looks at the bag, whose chunks close by time, and at the graph."""


class SaveSnapshot(Message):
    """Write the messages that are kept in memory."""


class SnapshotSaved(Message):
    """The bag that was written and its account; "" if none are kept."""

    text: str


class Recorder(Node):
    """Record the graph into a bag."""

    params: RecorderParams

    save = Srv(SaveSnapshot, SnapshotSaved)
    diagnostics = Pub(DiagnosticStatus, qos=Qos(durability="transient_local", depth=1))
    arrival, turn = Alarm(), Alarm()

    _recorder: LiveRecorder | None = None

    def on_graph_ready(self, run_dir: str) -> None:
        record = read_record(Path(run_dir))
        assert record is not None
        self._recorder = LiveRecorder(RunningGraph(record), self.params, self.log.info, from_start=True)
        self._recorder.await_topics(lambda: False)

    def on_activate(self) -> None:
        if self._recorder is None:
            raise GraphError("a recorder begins with its graph; record a running one with palp bag record")
        self._recorder.feed.start_ns = monotonic_ns() - self.now_ns()
        self.turn.set(self.now_ns())

    @on(arrival)
    def gather(self) -> None:
        self.turn.set(self.now_ns() + GATHER_NS)

    @on(turn)
    def receive(self) -> None:
        assert self._recorder is not None
        if self._recorder.turn(wait_ms=0):
            self.turn.set(self.now_ns())
        elif descriptors := self._recorder.feed.file_descriptors:
            self.arrival.set(self.now_ns() + LONGEST_WAIT_NS, descriptors)
        else:
            self.gather()
        self._save_trouble()

    def _save_trouble(self, *, at_once: bool = False) -> None:
        """Write what is kept after a trouble; the launcher enters it among the run's incidents."""
        assert self._recorder is not None
        try:
            text = self._recorder.save_trouble(at_once=at_once)
        except BagError as error:
            text = str(error)
        if text:
            self.log.warning("%s", text)
            for level, shown in (("warn", text), ("ok", "")):
                self.diagnostics.publish(DiagnosticStatus(stamp_ns=self.now_ns(), level=level, text=shown))

    @serve(save)
    def save_snapshot(self, _: SaveSnapshot) -> SnapshotSaved:
        if self._recorder is None or not self.params.snapshot_s:
            return SnapshotSaved(text="")
        try:
            return SnapshotSaved(text=self._recorder.save())
        except BagError as error:  # the recorder goes on
            return SnapshotSaved(text=str(error))

    def on_error(self, error: Exception) -> None:
        if isinstance(error, BagError) and self._recorder is not None:
            self._recorder.abandon()
            self._recorder = None

    def on_deactivate(self) -> None:
        """Finish the bag with what is still on its way."""
        if self._recorder is not None:
            self._save_trouble(at_once=True)
            recorder, self._recorder = self._recorder, None
            self.log.info("%s", recorder.close(patient=True).text())

    def on_shutdown(self) -> None:
        self.on_deactivate()
