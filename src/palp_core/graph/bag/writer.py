"""Write a bag: a folder ``NAME`` with ``NAME_0.mcap``, ``NAME_1.mcap`` ... and ``metadata.yaml``."""

import os
import shutil
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec

from palp_core.errors import BagError
from palp_core.graph.bag.mcap.chunk import Compression
from palp_core.graph.bag.mcap.file_writer import CHUNK_BYTES, FileWriter
from palp_core.graph.bag.mcap.records import Attachment, Metadata
from palp_core.graph.bag.metadata import FilePart, write_metadata
from palp_core.graph.bag.stream import Stream
from palp_core.graph.messages.topic import Topic

_NEVER = 1 << 64
MAX_CHANNELS = 0xFFFF


@contextmanager
def whole_folder(out: str | Path) -> Iterator[Path]:
    """Give the path at which to write a new folder; it takes its name when it is whole, else never."""
    folder = Path(out)
    if os.path.lexists(folder):
        raise BagError(f"{folder} exists already: choose another name")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = TemporaryDirectory(".part", f".{folder.name}.", folder.parent, ignore_cleanup_errors=True)
    except OSError as error:
        raise BagError(f"{folder} cannot be made: {error.strerror}") from error
    with part as made:
        yield Path(made, folder.name)
        Path(made, folder.name).rename(folder)


class BagWriter(AbstractContextManager["BagWriter"]):
    """Writes a bag, in as many files as its limits ask for; of more than ``max_files`` the oldest is deleted.

    Every file is complete: it repeats the definitions, the attachments and, on channels marked
    ``repeated``, the last messages of latched topics.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        compression: Compression = "zstd",
        max_bytes: int = 0,
        max_duration_ns: int = 0,
        max_files: int = 0,
        chunk_bytes: int = CHUNK_BYTES,
        custom: Mapping[str, str] | None = None,
    ) -> None:
        self.folder = Path(folder)
        self._compression: Compression = compression
        self._max_bytes = max_bytes or _NEVER
        self._max_duration_ns = max_duration_ns
        self._max_files = max_files
        self.deleted = Counter[str]()  # messages by topic, of files that are no longer kept
        self._chunk_bytes = min(chunk_bytes, max_bytes) if max_bytes else chunk_bytes
        self._custom = dict(custom or {})
        self._streams: list[Stream] = []
        self._ids: dict[tuple[Any, ...], int] = {}
        self._extras: list[Attachment | Metadata] = []
        self._latched: dict[int, deque[tuple[int, int, int, bytes]]] = {}
        self._latched_topics: dict[str, deque[tuple[int, int, int, bytes]]] = {}
        self._parts: list[FilePart] = []
        self._counts: deque[dict[int, int]] = deque()  # messages by stream, of each part
        self._opened_count = 0
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}
        self._tick_ns: int | None = None
        self._closed = False
        self._split_ns = self._split_bytes = _NEVER
        if not self.folder.name.isprintable():
            raise BagError(f"{str(folder)!a}: a bag's name is in its files; choose one that is printable")
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError as error:
            raise BagError(f"{self.folder} exists already: choose another name") from error
        except OSError as error:
            raise BagError(f"{self.folder} cannot be made: {error.strerror}") from error
        try:
            self._open()
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)  # it was made just now
            raise BagError(f"{self.folder} cannot be written: {error.strerror}") from error

    def stream(self, stream: Stream) -> int:
        """Return the number of a stream, by which messages are written."""
        number = self._ids.get(stream.key)
        if number is None:
            number = len(self._streams) + 1
            if number > MAX_CHANNELS:
                raise BagError(f"{self.folder}: more than {MAX_CHANNELS} streams")
            self._streams.append(stream)
            self._ids[stream.key] = number
            self._add(number)
            if stream.topic.latched_depth and not stream.repeated:
                name, depth = stream.topic.name, stream.topic.latched_depth
                self._latched[number] = self._latched_topics.setdefault(name, deque(maxlen=depth))
        return number

    def _repeat_latched(self, log_ns: int) -> None:
        """Write the last messages of latched topics once more, so that a new file is complete."""
        for history in list(self._latched_topics.values()):
            for number, sequence, publish_ns, payload in history:
                repeated = self.stream(msgspec.structs.replace(self._streams[number - 1], repeated=True))
                self._file.write(repeated, sequence, log_ns, publish_ns, payload)

    def write(
        self, stream: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes | memoryview
    ) -> None:
        """Add a message; both times are on the graph's clock."""
        file = self._file
        if log_ns >= self._split_ns or file.written_bytes >= self._split_bytes:
            file = self._split(log_ns)
        if self._max_duration_ns and self._split_ns == _NEVER:
            self._split_ns = log_ns + self._max_duration_ns
        file.write(stream, sequence, log_ns, publish_ns, payload)
        if stream in self._latched:
            self._latched[stream].append((stream, sequence, publish_ns, bytes(payload)))

    def tick(self, now_ns: int) -> None:
        """Say what time it is on a monotonic clock, at least every 0.1 s; a chunk too old is closed."""
        self._tick_ns = now_ns
        self._file.tick(now_ns)

    def attach(
        self, name: str, data: bytes, media_type: str = "application/octet-stream", *, every_file: bool = True
    ) -> None:
        """Add an attachment, to this file and to each later one."""
        attachment = Attachment(0, 0, name, media_type, data)
        self._file.attach(attachment)
        if every_file:
            self._extras.append(attachment)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        metadata = Metadata(name, dict(values))
        self._file.add_metadata(metadata)
        self._extras.append(metadata)

    def __exit__(self, error: object, *_: object) -> None:
        (self.abandon if error else self.close)()

    def close(self) -> None:
        """Complete the last file and ``metadata.yaml``; both are on the disk afterwards."""
        if self._closed:
            return
        self._closed = True
        self._close_file()
        topics: dict[str, tuple[Topic, str, int]] = {}
        for number, stream in enumerate(self._streams, start=1):
            if not stream.repeated:
                count = sum(counts.get(number, 0) for counts in self._counts)
                count += topics.get(stream.topic.name, (None, "", 0))[2]
                topics[stream.topic.name] = (stream.topic, stream.encoding, count)
        write_metadata(self.folder, topics, self._parts, self._custom)

    def abandon(self) -> None:
        """Leave the bag as a crash would: it cannot be written any more, and what is written stays."""
        self._closed = True
        self._file.abandon()

    def _open(self) -> None:
        path = self.folder / f"{self.folder.name}_{self._opened_count}.mcap"
        self._opened_count += 1
        self._file = FileWriter(path, self._compression, self._chunk_bytes)
        self._split_ns = _NEVER
        for number in range(1, len(self._streams) + 1):
            self._add(number)
        for extra in self._extras:
            if isinstance(extra, Attachment):
                self._file.attach(extra)
            else:
                self._file.add_metadata(extra)
        self._split_bytes = self._max_bytes + self._file.written_bytes
        if self._tick_ns is not None:
            self._file.tick(self._tick_ns)

    def _add(self, number: int) -> None:
        stream = self._streams[number - 1]
        schema = stream.schema(number)
        schema_id = self._schema_ids.setdefault((schema.name, schema.encoding, schema.data), number)
        schema.id = schema_id
        self._file.add_schema(schema)
        self._file.add_channel(stream.channel(number, schema_id))

    def _split(self, log_ns: int) -> FileWriter:
        self._close_file()
        self._delete_oldest()
        self._open()
        self._repeat_latched(log_ns)
        return self._file

    def _close_file(self) -> None:
        file = self._file
        file.close()
        streams = self._streams
        count = sum(n for number, n in file.counts.items() if not streams[number - 1].repeated)
        self._parts.append(FilePart(file.path.name, file.start_ns, file.end_ns, count))
        self._counts.append(dict(file.counts))

    def _delete_oldest(self) -> None:
        while self._max_files and len(self._parts) >= self._max_files:
            (self.folder / self._parts.pop(0).name).unlink(missing_ok=True)
            for number, count in self._counts.popleft().items():
                stream = self._streams[number - 1]
                if not stream.repeated:
                    self.deleted[stream.topic.name] += count
