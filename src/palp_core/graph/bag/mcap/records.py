"""The records of an MCAP file as bytes: https://mcap.dev/spec, version 0.

The library ``mcap`` knows their fields; the bounds against damaged and hostile files, and the CRCs, are here.
Every record is ``opcode u8 | length u64 | content``; all numbers are little-endian.
"""

import struct
import zlib
from io import BytesIO
from typing import Protocol, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode as Op
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

__all__ = [
    "Attachment", "AttachmentIndex", "Channel", "ChunkIndex", "DataEnd", "Footer", "Header", "Metadata",
    "MetadataIndex", "Op", "Schema", "Statistics", "SummaryOffset",
]  # fmt: skip

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "palp"
"""Who writes a file, as its header says."""

HEADER_SEEN_BYTES = 256
"""Of a file's first bytes; its header is in them."""

RECORD = struct.Struct("<BQ")
RECORD_BYTES = RECORD.size
MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time; the payload follows."""
MESSAGE_BYTES = MESSAGE.size
MESSAGE_INDEX = struct.Struct("<BQHI")
"""Opcode, length, channel, bytes of the pairs (log time, offset in the chunk) that follow."""
CRC_KEY = "crc32"
"""Of metadata: palp adds a CRC over the other values, as the format has none."""

T = TypeVar("T", covariant=True)


class RecordKind(Protocol[T]):
    def read(self, stream: ReadDataStream, /) -> T:
        """Take a record apart."""


class _Content(ReadDataStream):
    """A record's content; whatever does not fit is a ValueError."""

    def __init__(self, data: bytes | memoryview) -> None:
        super().__init__(BytesIO(data))
        self.size = len(data)

    def read(self, length: int) -> bytes:
        if length > self.size - self.count:
            raise ValueError(f"{length} bytes expected, {self.size - self.count} left")
        return super().read(length)


def pack(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def parse(kind: RecordKind[T], content: bytes | memoryview) -> T:
    """Take a record's content apart; a ValueError if it is not whole."""
    return kind.read(_Content(content))


def parse_attachment(content: bytes | memoryview) -> Attachment:
    """Take an attachment apart; a ValueError if it is not whole or its CRC does not match."""
    stream = _Content(content)
    found: Attachment = Attachment.read(stream)
    end = stream.count - 4
    if zlib.crc32(content[:end]) != int.from_bytes(content[end : stream.count], "little"):
        raise ValueError(f"attachment '{found.name}': the CRC does not match")
    return found


def pack_metadata(metadata: Metadata) -> bytes:
    """Return a metadata record as bytes, with a CRC."""
    return pack(Metadata(metadata.name, {**metadata.metadata, CRC_KEY: _crc_of(metadata)}))


def parse_metadata(content: bytes | memoryview) -> Metadata:
    """Take a metadata record apart; a ValueError if its CRC does not match; another program's has none."""
    found: Metadata = parse(Metadata, content)
    crc = found.metadata.pop(CRC_KEY, None)
    if crc is not None and crc != _crc_of(found):
        raise ValueError(f"metadata '{found.name}': the CRC does not match")
    return found


def _crc_of(metadata: Metadata) -> str:
    return f"{zlib.crc32(pack(metadata)[RECORD_BYTES:]):08x}"
