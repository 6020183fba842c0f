"""Record a lockstep run into a bag that stands alone: topics, graph, parameters, versions, git state."""

from palp_core.errors import BagError
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.selection import topic_selection
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.clock import monotonic_ns, unix_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.recording.provenance import (
    LAUNCH_ATTACHMENT,
    attachments,
    launch_attachment,
    launch_provenance,
)
from palp_core.graph.recording.recorder_messages import RecordOptions

TICK_FRAMES = 64


class LockstepRecorder:
    """Observes a lockstep graph and writes its bag.

    Args:
        name: By which it is spoken of.
        graph: The graph about to run.
        options: What to record, and how.

    Raises:
        BagError: The bag exists or cannot be made; or snapshots are wanted, for which nobody asks in time.
    """

    def __init__(self, name: str, graph: CheckedGraph, options: RecordOptions) -> None:
        if options.snapshot_s:
            raise BagError(f"{graph.file}: a recorder keeps the last seconds on the wall clock only")
        select = topic_selection(options.topics, options.regex, options.exclude_regex)
        writer = BagWriter(
            options.out,
            compression=options.compression,
            max_bytes=options.max_bytes,
            max_duration_ns=round(options.max_duration_s * 1e9),
            custom={"start_unix_ns": str(unix_ns())},
        )
        topics = [info.as_topic(name) for name, info in graph.topics.items()]
        try:
            self._recorder = BagRecorder(
                writer,
                topics,
                select=select,
                attachments=attachments(launch_provenance(graph)),
            )
        except OSError as error:
            writer.abandon()
            raise BagError(f"{options.out} cannot be written: {error.strerror}") from error
        self.name, self.out = name, options.out
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
        """Close the bag; return whether nothing is missing, and what to say."""
        try:
            summary = self._recorder.close()
        except OSError as error:
            return False, self.fail(error)
        return summary.complete, f"{self.out}: {summary.text()}"

    def fail(self, error: OSError) -> str:
        """Leave a bag that cannot be written any more; return what to say."""
        self._recorder.abandon()
        return (
            f"{self.out}: cannot be written any more: {error.strerror or error}; "
            f"save what it has: palp bag recover {self.out} -o NEW"
        )
