"""A recorder that ends when a signal asks for it, and one that keeps seconds in memory until one asks."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

from palp_core.errors import BagError
from palp_core.graph.discovery.choice import addressed
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.recording.live_recorder import LiveRecorder
from palp_core.graph.recording.recorder_messages import RecordOptions
from palp_core.user_folders import no_room

FOLDER = "recorders"
ANSWER_S = 30.0


class SnapshotRequests:
    """Requests for a snapshot of what a recorder keeps, on a socket in the run directory.

    Args:
        folder: The run directory.

    Raises:
        BagError: There is no room in it.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / FOLDER / str(os.getpid())
        self._socket = socket.socket(socket.AF_UNIX)
        try:
            self._path.parent.mkdir(mode=0o700, exist_ok=True)
            self._socket.bind(str(self._path))
        except OSError as error:
            self._socket.close()
            raise BagError(no_room(self._path.parent, error)) from error
        self._socket.listen()
        self._socket.setblocking(False)

    def accept(self) -> list[socket.socket]:
        """Return the connections of those who ask now."""
        found = []
        with contextlib.suppress(BlockingIOError):
            while True:
                found.append(self._socket.accept()[0])
        return found

    def close(self) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)


class RecorderRun:
    """A recorder with its signals: SIGINT, SIGTERM and SIGHUP end it, SIGUSR1 writes a snapshot.

    Args:
        say: Takes what a person should know.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.asked = False
        self._save = 0
        self._say = say

    def end(self, *_: object) -> None:
        self.asked = True

    def end_wanted(self) -> bool:
        return self.asked

    def save(self, *_: object) -> None:
        self._save += 1

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        ends = dict.fromkeys((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), self.end)
        before = {number: signal.signal(number, handle) for number, handle in ends.items()}
        before[signal.SIGUSR1] = signal.signal(signal.SIGUSR1, self.save)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def record(
        self, graph: RunningGraph, options: RecordOptions, begun: Callable[[], None] = lambda: None
    ) -> tuple[bool, str]:
        """Record until the end is asked for, or the graph has ended.

        Args:
            graph: The running graph.
            options: What and how.
            begun: Called when every topic has been heard.

        Returns:
            Whether nothing is missing, and what to say.

        Raises:
            PalpError: It cannot be recorded, or the disk is full.
        """
        recorder = LiveRecorder(graph, options, self._say)
        try:
            with contextlib.ExitStack() as stack:
                requests = SnapshotRequests(graph.folder) if options.snapshot_s else None
                if requests is not None:
                    stack.callback(requests.close)
                try:
                    if recorder.await_topics(self.end_wanted):
                        begun()
                        recorder.run(lambda: self._save_if_asked(recorder, requests))
                finally:
                    summary = recorder.close(patient=not self.asked)
        except OSError as error:
            raise BagError(
                f"{options.out} cannot be written: {error.strerror or error}; "
                f"save what it has: palp bag recover {options.out} -o NEW"
            ) from error
        if self._save:
            self._write(recorder, [])
        text = f"heard {summary.text()}" if options.snapshot_s else f"{options.out}: {summary.text()}"
        if recorder.unmatched:
            text += f"\nnever heard: {', '.join(recorder.unmatched)}"
        return summary.complete and not recorder.unmatched, text

    def _save_if_asked(self, recorder: LiveRecorder, requests: SnapshotRequests | None) -> bool:
        askers = requests.accept() if requests is not None else []
        if self._save or askers:
            self._write(recorder, askers)
        return self.end_wanted()

    def _write(self, recorder: LiveRecorder, askers: list[socket.socket]) -> None:
        self._save = 0
        try:
            text = recorder.save()
        except BagError as error:
            text = str(error)
        self._say(text)
        for asker in askers:
            with contextlib.suppress(OSError), asker:  # it may have gone
                asker.sendall(text.encode())


def record_until_asked(
    graph: RunningGraph, options: RecordOptions, say: Callable[[str], None]
) -> tuple[bool, str]:
    """Record a running graph; return whether nothing is missing, and what to say.

    Raises:
        PalpError: It cannot be recorded.
    """
    run = RecorderRun(say)
    with run.signals():
        return run.record(graph, options)


def save_snapshots(graph: RunningGraph) -> list[str]:
    """Let every recorder that keeps a graph's last seconds write them; return what each answers.

    Raises:
        BagError: There is none, or one does not answer.
    """
    folder = graph.folder / FOLDER
    with contextlib.ExitStack() as stack:
        asked: dict[str, socket.socket] = {}
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            asker = stack.enter_context(socket.socket(socket.AF_UNIX))
            with contextlib.suppress(ConnectionRefusedError, FileNotFoundError):  # killed; just ended
                asker.connect(str(path))
                asker.settimeout(ANSWER_S)
                asked[path.name] = asker
        if not asked:
            start_one = addressed("palp bag record -a --snapshot S", graph.record.id)
            raise BagError(f"no recorder keeps this graph's last seconds; start one: {start_one}")
        return [_answer(pid, asker) for pid, asker in asked.items()]


def _answer(pid: str, asker: socket.socket) -> str:
    answer = b""
    with contextlib.suppress(OSError):
        while part := asker.recv(1 << 16):
            answer += part
    if not answer:
        raise BagError(f"recorder {pid} did not write its snapshot")
    return answer.decode()
