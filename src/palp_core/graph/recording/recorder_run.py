"""A recorder that ends when a signal asks for it, and one that keeps seconds in memory until one asks."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

import msgspec

from palp_core.errors import BagError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.choice import addressed
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.recording.live_recorder import LiveRecorder
from palp_core.graph.recording.recorder_messages import RecordOptions
from palp_core.user_folders import no_room
from palp_core.whole_file import is_locked, open_private

FOLDER = "recorders"
ANSWER_NS = 30_000_000_000


class SnapshotNote(msgspec.Struct):
    """What a recorder in snapshot mode leaves in the run directory: who it is, what it has written."""

    pid: int
    out: str
    saved: list[str]


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
        """Ask for the end."""
        self.asked = True

    def end_wanted(self) -> bool:
        """Tell whether the end is asked for."""
        return self.asked

    def save(self, *_: object) -> None:
        """Ask for a snapshot."""
        self._save += 1

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """Take the signals."""
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
        told: _NoteFile | None = None
        try:
            with contextlib.ExitStack() as stack:
                told = stack.enter_context(_noted(graph, options)) if options.snapshot_s else None
                try:
                    if recorder.await_topics(self.end_wanted):
                        begun()
                        recorder.run(lambda: self._save_if_asked(recorder, told))
                finally:
                    summary = recorder.close(patient=not self.asked)
        except OSError as error:
            raise BagError(
                f"{options.out} cannot be written: {error.strerror or error}; "
                f"save what it has: palp bag recover {options.out} -o NEW"
            ) from error
        if self._save:
            self._write(recorder, told)
        text = f"heard {summary.text()}" if options.snapshot_s else f"{options.out}: {summary.text()}"
        if recorder.unheard:
            text += f"\nnever heard: {', '.join(recorder.unheard)}"
        return summary.complete and not recorder.unheard, text

    def _save_if_asked(self, recorder: LiveRecorder, told: _NoteFile | None) -> bool:
        if self._save:
            self._write(recorder, told)
        return self.end_wanted()

    def _write(self, recorder: LiveRecorder, told: _NoteFile | None) -> None:
        self._save = 0
        try:
            text = recorder.save()
        except BagError as error:
            text = str(error)
        self._say(text)
        if told is not None:
            told.add(text)


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


def save_snapshots(graph: RunningGraph, number: signal.Signals = signal.SIGUSR1) -> list[str]:
    """Let every recorder that keeps a graph's last seconds write them; return what they say.

    Raises:
        BagError: There is none, or one does not answer.
    """
    files = [path for path in sorted((graph.folder / FOLDER).glob("*.json")) if is_locked(path)]
    if not files:
        start_one = addressed("palp bag record -a --snapshot S", graph.record.id)
        raise BagError(f"no recorder keeps this graph's last seconds; start one: {start_one}")
    before = {path: _read(path) for path in files}
    for kept in before.values():
        os.kill(kept.pid, number)
    end_ns = monotonic_ns() + ANSWER_NS
    lines = []
    for path, kept in before.items():
        while len((now := _read(path)).saved) == len(kept.saved):
            if monotonic_ns() > end_ns or not is_locked(path):
                raise BagError(f"recorder {kept.pid} did not write its snapshot")
            signal.sigtimedwait((), 0.02)
        lines += now.saved[len(kept.saved) :]
    return lines


class _NoteFile:
    """The note that a recorder keeps in the run directory."""

    def __init__(self, path: Path, kept: SnapshotNote, lock: TextIO) -> None:
        self._path, self._kept, self._lock = path, kept, lock

    def add(self, text: str) -> None:
        """Say that a snapshot has been written; the file stays the locked one."""
        self._kept.saved.append(text)
        self.write()

    def write(self) -> None:
        """Write the note."""
        self._lock.seek(0)
        self._lock.write(msgspec.json.encode(self._kept).decode())
        self._lock.truncate()
        self._lock.flush()


@contextlib.contextmanager
def _noted(graph: RunningGraph, options: RecordOptions) -> Iterator[_NoteFile]:
    folder = graph.folder / FOLDER
    path = folder / f"{os.getpid()}.json"
    with contextlib.ExitStack() as stack:
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            lock = stack.enter_context(open(path, "w", opener=open_private))
            fcntl.flock(lock, fcntl.LOCK_EX)
            told = _NoteFile(path, SnapshotNote(os.getpid(), options.out, []), lock)
            told.write()
        except OSError as error:
            raise BagError(no_room(folder, error)) from error
        yield told
    path.unlink(missing_ok=True)


def _read(path: Path) -> SnapshotNote:
    """Read a note; while it is being written, read it again."""
    for _ in range(100):
        with contextlib.suppress(msgspec.MsgspecError, OSError):
            return msgspec.json.decode(path.read_bytes(), type=SnapshotNote)
        signal.sigtimedwait((), 0.01)
    raise BagError(f"{path} cannot be read")
