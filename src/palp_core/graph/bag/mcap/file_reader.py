"""Read one MCAP file: by its summary where that is whole, then through the records that it leaves out.

Nothing is believed unchecked: a summary and every chunk must match their CRC, and a chunk its entry in the
summary. A file without summary (its writer was killed) is read as far as it goes. Messages may be outside
chunks, as rosbag2's ``fastwrite`` puts them.
"""

import struct
import zlib
from collections.abc import Callable, Container, Iterator
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from palp_core.errors import BagDamaged, BagError
from palp_core.graph.bag.mcap import records
from palp_core.graph.bag.mcap.chunk import DEFINITIONS, RawMessage, made_by_palp, open_chunk, split_chunk

T = TypeVar("T", records.Attachment, records.Metadata)
_FOOTER_BYTES = records.RECORD_BYTES + 20
_PEEK_BYTES = records.RECORD_BYTES + 6
_STRETCH_BYTES = 1 << 20
PRIVATE = 0x80  # opcodes from here on are for other programs' own records


class ChunkPlace(NamedTuple):
    """Where a chunk's record is, or a stretch of messages outside chunks.

    Attributes:
        entry: The chunk's entry in the summary, if there is one.
        bare: There is no chunk around these records.
    """

    offset: int
    length: int
    entry: records.ChunkIndex | None = None
    bare: bool = False

    def open(self, data: bytes, *, has_crc: bool) -> bytes:
        """Return the records of the chunk or the stretch, given all its bytes; errors as of `open_chunk`."""
        return data if self.bare else open_chunk(data, self.entry, has_crc=has_crc)


def extend_places(places: list[ChunkPlace], offset: int, length: int) -> None:
    """Add a message outside chunks, to the last stretch if it follows it and there is room."""
    last = places[-1] if places else None
    if last and last.bare and last.offset + last.length == offset and last.length < _STRETCH_BYTES:
        places[-1] = last._replace(length=last.length + length)
    else:
        places.append(ChunkPlace(offset, length, bare=True))


def take_definition(op: int, content: memoryview, known: Any) -> None:
    """Add a schema or a channel to those known; a ValueError if it makes no sense or contradicts one."""
    if op == records.Op.SCHEMA:
        schema = records.parse(records.Schema, content)
        if known.schemas.setdefault(schema.id, schema) != schema:
            raise ValueError(f"two definitions of schema {schema.id}")
    else:
        channel = records.parse(records.Channel, content)
        if known.channels.setdefault(channel.id, channel) != channel:
            raise ValueError(f"two definitions of channel {channel.id}")


class FileReader(AbstractContextManager["FileReader"]):
    """Reads one file.

    Attributes:
        closed: Its writer came to its end, as a whole summary shows, or a walk through it to its end.
        schemas, channels: Definitions known so far; all of them after `find_definitions`.
        statistics: Counts of the whole file, if ``closed`` and written.
        chunks: Every chunk found, and every stretch of messages outside chunks, in file order.
        problems: What is wrong with the file.
        damage: Where the walk through it came to an early end.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.closed = False
        self.schemas: dict[int, records.Schema] = {}
        self.channels: dict[int, records.Channel] = {}
        self.statistics: records.Statistics | None = None
        self.chunks: list[ChunkPlace] = []
        self.problems: list[str] = []
        self._attachments: list[tuple[int, int]] = []
        self._metadata: list[tuple[int, int]] = []
        self._known_chunks: set[int] = set()
        self.damage: BagDamaged | None = None
        self._has_summary = True
        try:
            self._file = path.open("rb", buffering=1 << 16)
        except OSError as error:
            raise BagError(f"{path}: {error.strerror}") from error
        try:
            self.size = path.stat().st_size
            if self._read_at(0, len(records.MAGIC)) != records.MAGIC:
                raise BagDamaged(path, 0, "not an MCAP file")
            self._has_crcs = made_by_palp(self._read_at(0, records.HEADER_SEEN_BYTES))
            try:
                self.closed = self._read_summary()
            except (ValueError, struct.error) as error:
                self.problems.append(f"the summary is damaged: {error}")
            if not self.closed:
                self.chunks, self._attachments, self._metadata = [], [], []
                self.schemas, self.channels, self.statistics = {}, {}, None
                self._walk(len(records.MAGIC), self.size)
                self.closed = not self.problems
            else:
                self.find_definitions()
        except BaseException:
            self._file.close()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def messages(
        self, channels: Container[int] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[list[RawMessage]]:
        """Iterate messages in file order, chunk by chunk.

        Raises:
            BagDamaged: A chunk is not what was written, or the file ends amid a record; every whole chunk
                before it has been yielded.
        """
        timed = start_ns is not None or end_ns is not None
        low, high = start_ns or 0, 1 << 64 if end_ns is None else end_ns
        for place in self.chunks:
            if (index := place.entry) is not None:
                if index.message_end_time < low or index.message_start_time >= high:
                    continue
                listed = index.message_index_offsets
                if channels is not None and listed and not any(c in channels for c in listed):
                    continue
            found = self.read_chunk(place)
            if timed or channels is not None:
                found = [m for m in found if low <= m[2] < high and (channels is None or m[0] in channels)]
            yield found
        if self.damage is not None:
            raise self.damage

    def read_chunk(self, place: ChunkPlace) -> list[RawMessage]:
        """Return a chunk's messages, checked.

        Raises:
            BagDamaged: It is not what was written.
        """
        try:
            data = self._read_at(place.offset, place.length)
            self._known_chunks.add(place.offset)
            return split_chunk(place.open(data, has_crc=self._has_crcs), self._define)
        except (ValueError, struct.error) as error:
            raise BagDamaged(self.path, place.offset, f"a chunk is damaged: {error}") from error

    @property
    def extras(self) -> list[tuple[int, int]]:
        """Offset and length of every attachment and metadata record."""
        return [*self._attachments, *self._metadata]

    def attachments(self) -> dict[str, bytes]:
        """Return the attachments by name; the last one of a name counts."""
        found = [self._parsed(records.parse_attachment, *place) for place in self._attachments]
        return {attachment.name: attachment.data for attachment in found}

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records by name; the last one of a name counts."""
        found = [self._parsed(records.parse_metadata, *place) for place in self._metadata]
        return {metadata.name: metadata.metadata for metadata in found}

    def _read_at(self, offset: int, size: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(min(size, self.size))

    def _define(self, op: int, content: memoryview) -> None:
        take_definition(op, content, self)

    def _parsed(self, parse: Callable[[memoryview], T], offset: int, length: int) -> T:
        try:
            return parse(memoryview(self._read_at(offset, length))[records.RECORD_BYTES :])
        except (ValueError, struct.error) as error:
            raise BagDamaged(self.path, offset, str(error)) from error

    def _read_summary(self) -> bool:
        """Read the summary; return False where the writer did not come to writing it.

        Raises:
            ValueError: It is not what was written.
        """
        end = self.size - len(records.MAGIC) - _FOOTER_BYTES
        footer = self._read_at(max(end, 0), _FOOTER_BYTES + len(records.MAGIC))
        if (
            end < len(records.MAGIC)
            or footer[-len(records.MAGIC) :] != records.MAGIC
            or footer[0] != records.Op.FOOTER
        ):
            return False
        start, _, crc = struct.unpack_from("<QQI", footer, records.RECORD_BYTES)
        if start == 0:
            self._has_summary = self._has_crcs  # palp writes one, others need not
            return False
        if not len(records.MAGIC) <= start <= end:
            raise ValueError("its footer points outside the file")
        summary = memoryview(self._read_at(start, end - start))
        if crc and zlib.crc32(footer[: _FOOTER_BYTES - 4], zlib.crc32(summary)) != crc:
            raise ValueError("its CRC does not match")
        known: list[tuple[int, int]] = [(start, self.size)]
        offset = 0
        while offset < len(summary):
            op, length = records.RECORD.unpack_from(summary, offset)
            content = summary[offset + records.RECORD_BYTES : offset + records.RECORD_BYTES + length]
            offset += records.RECORD_BYTES + length
            if op in DEFINITIONS:
                self._define(op, content)
            elif op == records.Op.STATISTICS:
                self.statistics = records.parse(records.Statistics, content)
            elif op == records.Op.CHUNK_INDEX:
                index = records.parse(records.ChunkIndex, content)
                begin, length = index.chunk_start_offset, index.chunk_length
                self.chunks.append(ChunkPlace(begin, length, index))
                known.append((begin, begin + length + index.message_index_length))
            elif op == records.Op.ATTACHMENT_INDEX:
                attachment = records.parse(records.AttachmentIndex, content)
                self._attachments.append((attachment.offset, attachment.length))
                known.append((attachment.offset, attachment.offset + attachment.length))
            elif op == records.Op.METADATA_INDEX:
                metadata = records.parse(records.MetadataIndex, content)
                self._metadata.append((metadata.offset, metadata.length))
                known.append((metadata.offset, metadata.offset + metadata.length))
        end = len(records.MAGIC)
        for begin, known_end in sorted(known):
            self._walk(end, begin)
            end = known_end
        self.chunks.sort(key=lambda place: place.offset)
        return True

    def find_definitions(self) -> None:
        """Read chunks until every channel is defined; without a summary, all that were not read."""
        wanted = {
            channel for place in self.chunks if place.entry for channel in place.entry.message_index_offsets
        }
        if self.statistics is not None:
            wanted |= self.statistics.channel_message_counts.keys()
        for place in self.chunks:
            listed = place.bare or place.entry or self.statistics
            if not (place.offset in self._known_chunks or (listed and wanted <= self.channels.keys())):
                with suppress(BagDamaged):  # reading the messages raises it
                    self.read_chunk(place)

    def _walk(self, offset: int, end: int) -> None:
        """Go from record to record; note chunks, attachments, metadata, and what is outside chunks."""
        while offset < end:
            head = self._read_at(offset, _PEEK_BYTES)
            if len(head) < records.RECORD_BYTES:
                return self._note_damage(offset, "the file ends amid a record")
            op, length = records.RECORD.unpack_from(head)
            size = records.RECORD_BYTES + length
            if (
                op == 0
                or records.Op.DATA_END < op < (0x100 if self._has_crcs else PRIVATE)
                or (offset == len(records.MAGIC)) != (op == records.Op.HEADER)
                or (op == records.Op.MESSAGE and self._has_crcs)  # palp writes none outside chunks
            ):
                return self._note_damage(offset, "no record begins here")
            if offset + size > end:
                return self._note_damage(offset, "the file ends amid a record")
            if op == records.Op.CHUNK:
                self.chunks.append(ChunkPlace(offset, size))
            elif op == records.Op.MESSAGE:
                extend_places(self.chunks, offset, size)
            elif op in DEFINITIONS and not self._has_crcs:
                try:
                    self._define(op, memoryview(self._read_at(offset, size))[records.RECORD_BYTES :])
                except ValueError as error:
                    return self._note_damage(offset, str(error))
            elif op == records.Op.ATTACHMENT:
                self._attachments.append((offset, size))
            elif op == records.Op.METADATA:
                self._metadata.append((offset, size))
            elif op == records.Op.MESSAGE_INDEX and head[11:15] != struct.pack("<I", max(length - 6, 0)):
                return self._note_damage(offset, "a message index is damaged")
            elif op == records.Op.DATA_END:
                if end == self.size and self._has_summary and not self.problems:
                    self.problems.append("the summary is missing, or something follows it")
                return None
            offset += size
        if end == self.size:
            self.problems.append("it was not closed: its writer ended without warning")
        return None

    def _note_damage(self, offset: int, why: str) -> None:
        self.damage = BagDamaged(self.path, offset, why)
        self.problems.append(f"at byte {offset} of {self.size}: {why}")
