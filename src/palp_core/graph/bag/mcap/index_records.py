"""The records of an MCAP file's summary: where everything is, and how much of it."""

from __future__ import annotations

import struct

import msgspec

from palp_core.graph.bag.mcap.records import Cursor, Op, record, text


class ChunkIndex(msgspec.Struct, frozen=True):
    """Where a chunk is and what times and channels it holds."""

    start_ns: int
    end_ns: int
    offset: int
    length: int
    channels: dict[int, int]
    """Per channel, where its message index is."""
    index_bytes: int
    compression: str
    compressed_bytes: int
    uncompressed_bytes: int

    def pack(self) -> bytes:
        places = b"".join(struct.pack("<HQ", channel, place) for channel, place in self.channels.items())
        return record(
            Op.CHUNK_INDEX,
            struct.pack("<QQQQ", self.start_ns, self.end_ns, self.offset, self.length),
            struct.pack("<I", len(places)) + places,
            struct.pack("<Q", self.index_bytes) + text(self.compression),
            struct.pack("<QQ", self.compressed_bytes, self.uncompressed_bytes),
        )

    @classmethod
    def parse(cls, content: bytes | memoryview) -> ChunkIndex:
        cursor = Cursor(content)
        start, end, offset, length = cursor.u64(), cursor.u64(), cursor.u64(), cursor.u64()
        places = Cursor(cursor.raw(cursor.u32()))
        channels = {}
        while places.more():
            channel = places.u16()
            channels[channel] = places.u64()
        return cls(
            start, end, offset, length, channels, cursor.u64(), cursor.text(), cursor.u64(), cursor.u64()
        )


class AttachmentIndex(msgspec.Struct, frozen=True):
    """Where an attachment is."""

    offset: int
    length: int
    log_ns: int
    create_ns: int
    data_bytes: int
    name: str
    media_type: str

    def pack(self) -> bytes:
        numbers = (self.offset, self.length, self.log_ns, self.create_ns, self.data_bytes)
        return record(
            Op.ATTACHMENT_INDEX, struct.pack("<QQQQQ", *numbers), text(self.name), text(self.media_type)
        )

    @classmethod
    def parse(cls, content: bytes | memoryview) -> AttachmentIndex:
        cursor = Cursor(content)
        offset, length, log_ns, create_ns, size = (cursor.u64() for _ in range(5))
        return cls(offset, length, log_ns, create_ns, size, cursor.text(), cursor.text())


class MetadataIndex(msgspec.Struct, frozen=True):
    """Where a metadata record is."""

    offset: int
    length: int
    name: str

    def pack(self) -> bytes:
        return record(Op.METADATA_INDEX, struct.pack("<QQ", self.offset, self.length), text(self.name))

    @classmethod
    def parse(cls, content: bytes | memoryview) -> MetadataIndex:
        cursor = Cursor(content)
        return cls(cursor.u64(), cursor.u64(), cursor.text())


class Statistics(msgspec.Struct, frozen=True):
    """Counts of a whole file."""

    start_ns: int
    end_ns: int
    schema_count: int
    attachment_count: int
    metadata_count: int
    chunk_count: int
    counts: dict[int, int]
    """Messages per channel."""

    def pack(self) -> bytes:
        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in self.counts.items())
        head = (sum(self.counts.values()), self.schema_count, len(self.counts), self.attachment_count)
        tail = (self.metadata_count, self.chunk_count, self.start_ns, self.end_ns, len(counts))
        return record(Op.STATISTICS, struct.pack("<QHIIIIQQI", *head, *tail), counts)

    @classmethod
    def parse(cls, content: bytes | memoryview) -> Statistics:
        cursor = Cursor(content)
        head = struct.unpack("<QHIIIIQQ", cursor.raw(42))
        places = Cursor(cursor.raw(cursor.u32()))
        counts = {}
        while places.more():
            channel = places.u16()
            counts[channel] = places.u64()
        return cls(head[6], head[7], head[1], head[3], head[4], head[5], counts)
