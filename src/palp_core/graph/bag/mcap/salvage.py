"""Find every intact chunk of a damaged file, and messages outside chunks, whatever is broken around them."""

import mmap
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import msgspec

from palp_core.errors import BagDamaged, BagError
from palp_core.graph.bag.mcap import records
from palp_core.graph.bag.mcap.chunk import (
    DEFINITIONS,
    RawMessage,
    made_by_palp,
    open_chunk,
    read_chunk_head,
    split_chunk,
)
from palp_core.graph.bag.mcap.file_reader import ChunkPlace, FileReader, extend_places, take_definition

_CHUNK = re.compile(
    rb"\x06.{5}\x00{3}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})",
    re.DOTALL,
)
"""How a chunk begins: opcode, a length below 2**40, times, size, CRC, the name of a compression."""
_MESSAGE = re.compile(rb"\x05.{5}\x00{3}", re.DOTALL)
"""How a message begins: opcode, a length below 2**40."""


class Salvage(msgspec.Struct, kw_only=True):
    """What is intact in a file.

    Attributes:
        chunks: Every chunk whose CRC matches, or that has none, and every stretch of messages outside chunks.
        unchecked: Offsets of those that no CRC covers.
        ended: Its messages come to an end that its writer wrote.
        torn: Offset of a last chunk that the file's end cuts off and that is not compressed, or -1.
        damaged_chunk_count: Chunks that are not what was written.
        damaged_bytes: Bytes that belong to nothing intact.
        problems: What is wrong with the file, as far as opening it shows, and with its first damaged chunk.
    """

    path: Path
    chunks: list[ChunkPlace] = []
    unchecked: set[int] = set()
    has_crcs: bool = False
    ended: bool = False
    torn: int = -1
    damaged_chunk_count: int = 0
    damaged_bytes: int = 0
    problems: list[str] = []
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}
    attachments: dict[str, records.Attachment] = {}
    metadata: dict[str, records.Metadata] = {}

    def messages(self) -> Iterator[tuple[list[RawMessage], bool]]:
        """Iterate the intact messages in file order, stretch by stretch, and whether a CRC covers them."""
        with self.path.open("rb") as file:
            for place in self.chunks:
                file.seek(place.offset)
                data = place.open(file.read(place.length), has_crc=self.has_crcs)
                yield split_chunk(data, lambda *_: None), place.offset not in self.unchecked

    def torn_messages(self) -> list[RawMessage]:
        """Return the whole messages of the chunk that is cut off; no CRC covers them."""
        if self.torn < 0:
            return []
        with self.path.open("rb") as file:
            file.seek(self.torn)
            data = file.read()
        try:
            return split_chunk(bytes(read_chunk_head(data, torn=True)[5]), self.define, torn=True)
        except (ValueError, struct.error):
            return []

    def define(self, op: int, content: memoryview) -> None:
        """Take a schema or a channel; errors as of `take_definition`."""
        take_definition(op, content, self)


def salvage(path: Path) -> Salvage:
    """Look through a whole file, by its summary if that is intact, else record by record.

    Where no record begins, the search goes on for the next thing that looks like a chunk and has a CRC that
    matches.

    Raises:
        BagError: No such file.
    """
    found = Salvage(path=path)
    try:
        if path.stat().st_size == 0:
            found.problems = ["it is empty"]
            return found
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            found.has_crcs = made_by_palp(data[: records.HEADER_SEEN_BYTES])
            intact = _by_summary(found, path, data)
            if intact is None:
                intact = _by_search(found, data)
            found.damaged_bytes = len(data) - intact
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from error
    return found


def _by_summary(found: Salvage, path: Path, data: mmap.mmap) -> int | None:
    """Take what an intact summary names; return the intact bytes, or None if there is no such summary."""
    try:
        reader = FileReader(path)
    except BagDamaged:
        found.problems = ["not an MCAP file"]
        return None
    with reader:
        if reader.problems:
            found.problems = reader.problems
            return None
        found.schemas, found.channels, found.ended = dict(reader.schemas), dict(reader.channels), True
        broken = 0
        for place in reader.chunks:
            if not _take_place(found, data, place):
                broken += place.length
        for offset, length in reader.extras:
            if not _take_extra(found, data, offset, length):
                broken += length
    return len(data) - broken


def _by_search(found: Salvage, data: mmap.mmap) -> int:
    """Walk from record to record, search where none begins; return the intact bytes."""
    offset = len(records.MAGIC)
    intact = offset * (
        (data[:offset] == records.MAGIC) + (data[max(offset, len(data) - offset) :] == records.MAGIC)
    )
    doubt = 0  # behind the last thing that a CRC or what follows it confirms
    while True:
        length = _record_length(data, offset)
        if length is None:
            if _is_torn(data, offset):
                found.torn = offset
            offset = _next_start(found, data, doubt)
            length = _record_length(data, offset)
            if length is None:
                return intact
        op = data[offset]
        found.ended |= op == records.Op.DATA_END
        if op == records.Op.CHUNK:
            good = proven = _take_place(found, data, ChunkPlace(offset, length))
        elif op == records.Op.MESSAGE:
            good = proven = _is_message(found, data, offset, length)
            if good:
                extend_places(found.chunks, offset, length)
                found.unchecked.add(found.chunks[-1].offset)
        elif op in DEFINITIONS and not found.has_crcs:
            good = proven = _take_definition(found, data, offset, length)
        else:
            proven = op == records.Op.ATTACHMENT and _take_extra(found, data, offset, length)
            good = (
                proven
                or op not in (records.Op.ATTACHMENT, records.Op.METADATA)
                or _take_extra(found, data, offset, length)
            )
        if good:
            intact += length
            found.torn = -1 if op == records.Op.CHUNK else found.torn
        doubt = offset + (length if proven else 1)
        offset += length


def _next_start(found: Salvage, data: mmap.mmap, start: int) -> int:
    """Return where the next intact chunk begins, or the next message where there are no chunks; else -1."""
    for match in _CHUNK.finditer(data, start):
        length = _record_length(data, match.start())
        if length is not None:
            try:
                open_chunk(data[match.start() : match.start() + length], has_crc=found.has_crcs)
            except (ValueError, struct.error):
                continue
            return match.start()
    if found.torn >= 0 or not all(place.bare for place in found.chunks):
        return -1  # what looks like a message is in a damaged chunk
    for match in _MESSAGE.finditer(data, start):
        length = _record_length(data, match.start())
        if length is not None and _is_message(found, data, match.start(), length):
            return match.start()
    return -1


def _is_message(found: Salvage, data: mmap.mmap, offset: int, length: int) -> bool:
    """Say whether a record is a message of a known channel, and another record, or the end, follows it.

    Without that its length may be wrong: of a damaged record, the one before it is not saved either.
    """
    if found.has_crcs or length < records.MESSAGE_BYTES:  # palp writes none outside chunks
        return False
    channel = int(records.MESSAGE.unpack_from(data, offset)[2])
    end = offset + length
    if channel not in found.channels or end + records.RECORD_BYTES > len(data):
        return channel in found.channels
    op, next_length = records.RECORD.unpack_from(data, end)
    return bool(op <= records.Op.DATA_END and next_length < 1 << 40)


def _record_length(data: mmap.mmap, offset: int) -> int | None:
    """Return the length of the record that begins here, or None if none can."""
    if offset < 0 or offset + records.RECORD_BYTES > len(data):
        return None
    op, length = records.RECORD.unpack_from(data, offset)
    whole = records.RECORD_BYTES + int(length)
    return whole if 0 < op <= records.Op.DATA_END and offset + whole <= len(data) else None


def _take_place(found: Salvage, data: mmap.mmap, place: ChunkPlace) -> bool:
    schemas, channels = dict(found.schemas), dict(found.channels)
    try:
        chunk = data[place.offset : place.offset + place.length]
        split_chunk(place.open(chunk, has_crc=found.has_crcs), found.define)
    except (ValueError, struct.error) as error:
        found.schemas, found.channels = schemas, channels
        if not found.damaged_chunk_count:
            found.problems.append(f"at byte {place.offset}: a chunk is damaged: {error}")
        found.damaged_chunk_count += 1
        return False
    found.chunks.append(place)
    if place.bare or not (found.has_crcs or read_chunk_head(chunk)[3]):
        found.unchecked.add(place.offset)
    return True


def _take_definition(found: Salvage, data: mmap.mmap, offset: int, length: int) -> bool:
    try:
        found.define(data[offset], memoryview(data[offset + records.RECORD_BYTES : offset + length]))
    except ValueError:
        return False
    return True


def _take_extra(found: Salvage, data: mmap.mmap, offset: int, length: int) -> bool:
    content = memoryview(data[offset + records.RECORD_BYTES : offset + length])
    try:
        if data[offset] == records.Op.ATTACHMENT:
            attachment = records.parse_attachment(content)
            found.attachments[attachment.name] = attachment
        else:
            metadata = records.parse_metadata(content)
            found.metadata[metadata.name] = metadata
    except (ValueError, struct.error) as error:
        found.problems.append(f"at byte {offset}: {error}")
        return False
    return True


def _is_torn(data: mmap.mmap, offset: int) -> bool:
    """Say whether an uncompressed chunk begins here that the file's end cuts off."""
    if offset < 0:
        return False
    try:
        with memoryview(data)[offset:] as rest:
            _, _, size, _, compression, stored = read_chunk_head(rest, torn=True)
            there = len(stored)
    except (ValueError, struct.error):
        return False
    return compression == "" and there < size
