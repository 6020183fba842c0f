"""The recorders of a graph: of ``palp launch --record`` and of the launch file's entries."""

from __future__ import annotations

import contextlib
import itertools
import logging
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from palp_core.errors import BagError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.process.channel import ChannelClosed
from palp_core.graph.recording import recorder_messages
from palp_core.graph.recording.recorder_node import RecorderParams
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.supervision.sidecar import Sidecar

if TYPE_CHECKING:
    from palp_core.graph.recording.lockstep_recorder import LockstepRecorder
    from palp_core.graph.supervision.supervisor import Supervisor

DEFAULT_NAME = "recorder"
FINISH_NS = 60_000_000_000
_LOG = logging.getLogger("palp.supervisor")


class Recorders:
    """Every recorder of one graph.

    On the simulated clock the launcher itself writes the bags, as every message passes through it; on the
    wall clock each recorder is a process.

    Args:
        graph: The graph about to run; None: there is none yet, and nothing to record.
        out: A bag for all of it; None: only what the launch file says.
        resumed: The run was interrupted: each recorder of the launch file begins another bag
            beside the one that is there, ``bag_2`` beside ``bag``.

    Raises:
        BagError: A bag exists, or a recorder's flags make no sense.
    """

    def __init__(
        self,
        graph: CheckedGraph | None = None,
        out: Path | None = None,
        *,
        resumed: bool = False,
    ) -> None:
        self._results: list[tuple[bool, str]] = []
        self._writers: list[LockstepRecorder] = []
        self._processes: list[RecorderProcess] = []
        self._wanted: list[tuple[str, recorder_messages.RecordOptions, bool]] = []
        self._launcher_node: LauncherNode | None = None
        if out is not None:
            options = recorder_messages.RecordOptions(out=str(out.absolute()), from_start=True)
            self._wanted.append((DEFAULT_NAME, options, False))
        for spec in graph.recorders if graph is not None else ():
            params = msgspec.convert(spec.params, RecorderParams)
            if resumed:
                params = msgspec.structs.replace(params, out=_free(params.out))
            self._wanted.append((spec.name, _options(params), params.required))
        for name, options, _ in self._wanted:
            if Path(options.out).exists():
                raise BagError(f"{options.out} exists already: choose another name")
            if graph is not None and graph.clock == "sim":
                from palp_core.graph.recording.lockstep_recorder import LockstepRecorder

                self._writers.append(LockstepRecorder(name, graph, options))

    def observe(self, now_ns: int, frame: bytes) -> None:
        """Simulated clock: take a frame.

        Raises:
            NodeError: It cannot be recorded, and the launch file wants the graph to end with its recorder.
        """
        for writer in self._writers:
            try:
                writer(now_ns, frame)
            except OSError as error:
                self._lose(writer, error)

    def follow(self, graph: CheckedGraph) -> None:
        """Simulated clock: keep what the graph has become by a swap; other recorders ask for it.

        Raises:
            NodeError: As of :meth:`observe`.
        """
        for writer in self._writers:
            try:
                writer.follow(graph)
            except OSError as error:
                self._lose(writer, error)

    def _lose(self, writer: LockstepRecorder, error: OSError) -> None:
        """Go on without a bag that cannot be written any more, and say so."""
        self._writers = [other for other in self._writers if other is not writer]
        text = writer.fail(error)
        self._results.append((False, text))
        if self._launcher_node is not None:
            self._launcher_node.report("recorder", writer.name, text)
        _LOG.warning("%s: %s", writer.name, text)
        if writer.name in {name for name, _, required in self._wanted if required}:
            raise NodeError(writer.name, text)

    def start(self, folder: Path, launcher_node: LauncherNode, supervisor: Supervisor | None) -> None:
        """Wall clock: start the recorders; return when each hears every topic.

        Args:
            folder: The run directory.
            launcher_node: Knows where everything is, and is told when one ends.
            supervisor: Waits for what they say; None where all nodes are in this process.

        Raises:
            BagError: One cannot record.
        """
        self._launcher_node = launcher_node
        if self._writers or not self._wanted or supervisor is None or launcher_node.record is None:
            return
        for name, options, required in self._wanted:
            self._processes.append(
                RecorderProcess(
                    name, launcher_node.record, options, folder, launcher_node, supervisor, required=required
                )
            )
        for process in self._processes:
            supervisor.wait_until(lambda process=process: process.ready)  # type: ignore[misc]
            if process.refused:
                raise BagError(f"recorder '{process.name}': {process.refused}")

    def close(self) -> None:
        self._results += [writer.close() for writer in self._writers]
        for process in self._processes:
            process.finish()
        end_ns = monotonic_ns() + FINISH_NS  # of all together: a graph with two must not take twice as long
        self._results += [process.close(end_ns) for process in self._processes]
        self._writers, self._processes = [], []

    @property
    def complete(self) -> bool:
        """Nothing is missing in any of the bags."""
        return all(complete for complete, _ in self._results)

    @property
    def text(self) -> str:
        """What to say about the bags; "" if there are none."""
        return "\n".join(text for _, text in self._results)


class RecorderProcess:
    """One recorder's process, as the launcher sees it.

    Attributes:
        ready: It records, or it never will.
        refused: Why it cannot record; "" if it can.
    """

    def __init__(
        self,
        name: str,
        record: RunRecord,
        options: recorder_messages.RecordOptions,
        folder: Path,
        launcher_node: LauncherNode,
        supervisor: Supervisor,
        *,
        required: bool,
    ) -> None:
        self.name = name
        self.ready = False
        self.refused = ""
        self._options, self._required = options, required
        self._launcher_node, self._supervisor = launcher_node, supervisor
        self._result: tuple[bool, str] | None = None
        self._sidecar: Sidecar[recorder_messages.FromRecorder] = Sidecar(
            "palp_core.graph.recording.recorder_process",
            recorder_messages.from_recorder(),
            folder / "log" / f"{name}.log",
        )
        self._began = self._gone = False
        supervisor.watch(self._sidecar.descriptor, self._receive)
        with contextlib.suppress(ChannelClosed):
            self._sidecar.send(recorder_messages.StartRecording(record, options))

    def _receive(self) -> None:
        """Take what it says.

        Raises:
            NodeError: It is gone, and the launch file wants the graph to end with it.
        """
        try:
            for message in self._sidecar.receive():
                self._on_message(message)
        except ChannelClosed:
            self._on_gone()

    def _on_message(self, message: recorder_messages.FromRecorder) -> None:
        if isinstance(message, recorder_messages.RecordingStarted):
            self.ready = self._began = True
        elif isinstance(message, recorder_messages.RecorderNote):
            _LOG.log(logging.INFO if self.ready else logging.WARNING, "%s: %s", self.name, message.text)
        elif isinstance(message, recorder_messages.RecordingFinished):
            self._result = (message.complete, message.text)
        elif self._began:
            self._fail(message.text)
        else:
            self.ready, self.refused = True, message.text

    def _on_gone(self) -> None:
        self._supervisor.forget(self._sidecar.descriptor)
        self._gone = self.ready = True
        if self._result is None and not self.refused:
            out = self._options.out
            self._fail(f"the recorder has ended; save what it has written: palp bag recover {out} -o NEW")

    def _fail(self, text: str) -> None:
        """Say that there will be no whole bag.

        Raises:
            NodeError: The launch file wants the graph to end with its recorder.
        """
        out = self._options.out
        self._result = (False, text if text.startswith(out) else f"{out}: {text}")
        self._launcher_node.report("recorder", self.name, text)
        _LOG.warning("%s: %s", self.name, text)
        if not self._began:
            self.refused = "its process has ended"
        elif self._required:
            raise NodeError(self.name, text)

    def finish(self) -> None:
        self._required = False  # the graph has ended
        if not self._gone:
            self._supervisor.forget(self._sidecar.descriptor)
            self._sidecar.close_sending()

    def close(self, end_ns: int) -> tuple[bool, str]:
        """Wait for the bag's end, until then at most; return whether nothing is missing, and what to say."""
        if not self._gone:
            with contextlib.suppress(ChannelClosed):
                while self._result is None and self._sidecar.wait((end_ns - monotonic_ns()) / 1e9):
                    for message in self._sidecar.receive():
                        self._on_message(message)
        self._sidecar.close()
        return self._result or (False, f"{self._options.out}: the recorder did not finish its bag")


def _options(params: RecorderParams) -> recorder_messages.RecordOptions:
    return recorder_messages.RecordOptions(
        out=str(Path(params.out).absolute()),
        topics=[name if name.startswith("/") else f"/{name}" for name in params.topics],
        regex=params.regex or None,
        exclude_regex=params.exclude_regex or None,
        max_bytes=params.max_bag_size,
        max_duration_s=params.max_bag_duration_s,
        snapshot_s=params.snapshot_s,
        compression=params.compression,
        from_start=not params.snapshot_s,
    )


def _free(out: str) -> str:
    """Return a bag's name, or with a number that none beside it has."""
    names = itertools.chain([out], (f"{out}_{number}" for number in itertools.count(2)))
    return next(name for name in names if not Path(name).exists())
