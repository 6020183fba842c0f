"""The records of an MCAP file as bytes: https://mcap.dev/spec, version 0.

Every record is ``opcode u8 | length u64 | content``; all numbers are little-endian, a string is its length
(u32) and UTF-8, a map is its length in bytes (u32) and pairs.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from enum import IntEnum

import msgspec

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
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")


class Op(IntEnum):
    """What a record is."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


def record(op: int, *parts: bytes) -> bytes:
    """Return one record."""
    content = b"".join(parts)
    return RECORD.pack(op, len(content)) + content


def text(value: str) -> bytes:
    """Return a string with its length before it."""
    data = value.encode()
    return _U32.pack(len(data)) + data


def mapping(values: Mapping[str, str]) -> bytes:
    """Return a map of strings."""
    data = b"".join(text(key) + text(value) for key, value in values.items())
    return _U32.pack(len(data)) + data


class Cursor:
    """Takes a record's content apart; whatever does not fit is a ValueError."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self.offset = 0

    def raw(self, size: int) -> memoryview:
        """Take ``size`` bytes."""
        end = self.offset + size
        if end > len(self._data):
            raise ValueError(f"{size} bytes expected, {len(self._data) - self.offset} left")
        data = self._data[self.offset : end]
        self.offset = end
        return data

    def u16(self) -> int:
        value: int = _U16.unpack(self.raw(2))[0]
        return value

    def u32(self) -> int:
        value: int = _U32.unpack(self.raw(4))[0]
        return value

    def u64(self) -> int:
        value: int = _U64.unpack(self.raw(8))[0]
        return value

    def text(self) -> str:
        return str(self.raw(self.u32()), "utf-8")

    def mapping(self) -> dict[str, str]:
        inner = Cursor(self.raw(self.u32()))
        values = {}
        while inner.more():
            key = inner.text()
            values[key] = inner.text()
        return values

    def more(self) -> bool:
        """Say whether anything is left."""
        return self.offset < len(self._data)


class SchemaRecord(msgspec.Struct, frozen=True):
    """What the messages of a channel are made of."""

    id: int
    name: str
    encoding: str
    data: bytes

    def pack(self) -> bytes:
        parts = (
            _U16.pack(self.id),
            text(self.name),
            text(self.encoding),
            _U32.pack(len(self.data)),
            self.data,
        )
        return record(Op.SCHEMA, *parts)

    @classmethod
    def parse(cls, content: bytes | memoryview) -> SchemaRecord:
        cursor = Cursor(content)
        return cls(cursor.u16(), cursor.text(), cursor.text(), bytes(cursor.raw(cursor.u32())))


class ChannelRecord(msgspec.Struct, frozen=True):
    """One stream of messages."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str] = {}

    def pack(self) -> bytes:
        ids = _U16.pack(self.id) + _U16.pack(self.schema_id)
        return record(Op.CHANNEL, ids, text(self.topic), text(self.message_encoding), mapping(self.metadata))

    @classmethod
    def parse(cls, content: bytes | memoryview) -> ChannelRecord:
        cursor = Cursor(content)
        return cls(cursor.u16(), cursor.u16(), cursor.text(), cursor.text(), cursor.mapping())


class Attachment(msgspec.Struct, frozen=True):
    """A file within the file, with a CRC of its own."""

    name: str
    data: bytes
    media_type: str = "application/octet-stream"
    log_ns: int = 0
    create_ns: int = 0

    def pack(self) -> bytes:
        content = b"".join(
            (
                struct.pack("<QQ", self.log_ns, self.create_ns),
                text(self.name) + text(self.media_type),
                _U64.pack(len(self.data)),
                self.data,
            )
        )
        return record(Op.ATTACHMENT, content, _U32.pack(zlib.crc32(content)))

    @classmethod
    def parse(cls, content: bytes | memoryview) -> Attachment:
        cursor = Cursor(content)
        log_ns, create_ns, name, media_type = cursor.u64(), cursor.u64(), cursor.text(), cursor.text()
        data = bytes(cursor.raw(cursor.u64()))
        crc = zlib.crc32(memoryview(content)[: cursor.offset])
        if crc != cursor.u32():
            raise ValueError(f"attachment '{name}': the CRC does not match")
        return cls(name, data, media_type, log_ns, create_ns)


class Metadata(msgspec.Struct, frozen=True):
    """A named map of strings; palp adds the key ``crc32`` over the others, as the format has none."""

    name: str
    values: dict[str, str]

    def pack(self) -> bytes:
        values = {**self.values, "crc32": _crc(self.name, self.values)}
        return record(Op.METADATA, text(self.name), mapping(values))

    @classmethod
    def parse(cls, content: bytes | memoryview) -> Metadata:
        cursor = Cursor(content)
        name, values = cursor.text(), cursor.mapping()
        crc = values.pop("crc32", None)
        if crc is not None and crc != _crc(name, values):
            raise ValueError(f"metadata '{name}': the CRC does not match")
        return cls(name, values)


def _crc(name: str, values: Mapping[str, str]) -> str:
    return f"{zlib.crc32(text(name) + mapping(values)):08x}"
