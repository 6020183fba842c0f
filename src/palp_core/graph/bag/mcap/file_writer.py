"""Write one MCAP file, chunk by chunk.

A chunk is closed when it is full or when :meth:`FileWriter.tick` finds it half a second old, the first one at
the first tick that finds anything in it, and reaches the operating system in one write, so whatever happens
to this process, every closed chunk is whole in the file.
A channel's definition is in the first two chunks that use it and in the summary: no single damage makes
messages unreadable elsewhere.
"""

import contextlib
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import BagError
from palp_core.graph.bag.mcap import records
from palp_core.graph.bag.mcap.chunk import Compression, compressor

CHUNK_BYTES = 1 << 20
CHUNK_NS = 500_000_000
_DEFINED_TIMES = 2
_PAYLOAD_OFFSET = records.MESSAGE.size - records.RECORD_BYTES
MESSAGE_OP, _INDEX_OP = int(records.Op.MESSAGE), int(records.Op.MESSAGE_INDEX)


class FileWriter:
    """Writes one file; the caller reports that time has passed."""

    def __init__(
        self,
        path: Path,
        compression: Compression = "zstd",
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self.path = path
        self.written_bytes = 0
        self.counts: dict[int, int] = {}
        self.start_ns = self.end_ns = 0
        self._compression, self._compress = compressor(compression)
        self._chunk_bytes = chunk_bytes
        self._crc = 0
        self._schemas: dict[int, bytes] = {}
        self._channels: dict[int, tuple[int, bytes]] = {}
        self._chunks: list[records.ChunkIndex] = []
        self._attachments: list[records.AttachmentIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self._defined: dict[int, int] = {}
        self._buffer = bytearray()
        self._index: dict[int, tuple[list[int], list[int]]] = {}
        self._tick_ns: int | None = None
        self._opened_ns: int | None = None
        self._file = path.open("xb", buffering=0)
        try:
            self._write_bytes(records.MAGIC + records.pack(records.Header("", records.LIBRARY)))
        except OSError:
            self._file.close()
            raise

    def add_schema(self, schema: records.Schema) -> None:
        """Make a schema known; its id is 1 or more."""
        self._schemas[schema.id] = records.pack(schema)

    def add_channel(self, channel: records.Channel) -> None:
        """Make a channel known; its schema must be."""
        if channel.schema_id not in self._schemas:
            raise BagError(f"{channel.topic}: its schema {channel.schema_id} is not known to {self.path}")
        self._channels[channel.id] = (channel.schema_id, records.pack(channel))
        self.counts[channel.id] = 0

    def write(
        self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes | memoryview
    ) -> None:
        """Add a message; of the sequence, 32 bits are kept."""
        buffer = self._buffer
        try:
            head = records.MESSAGE.pack(
                MESSAGE_OP, _PAYLOAD_OFFSET + len(payload), channel, sequence & 0xFFFFFFFF, log_ns, publish_ns
            )
        except struct.error as error:
            raise BagError(f"{self.path}: a message at {log_ns} ns, stamped {publish_ns}: {error}") from error
        index = self._index.get(channel)
        if index is None:
            index = self._define(channel)
        index[0].append(log_ns)
        index[1].append(len(buffer))
        buffer += head
        buffer += payload
        if len(buffer) >= self._chunk_bytes:
            self.close_chunk()

    def tick(self, now_ns: int) -> None:
        """Say what time it is, on any monotonic clock; call it at least every 0.1 s."""
        if self._index:
            if self._opened_ns is None:  # the chunk was begun after the last tick
                self._opened_ns = now_ns if self._tick_ns is None else self._tick_ns
            if not self._chunks or now_ns - self._opened_ns >= CHUNK_NS:
                self.close_chunk()
        self._tick_ns = now_ns

    def close_chunk(self) -> None:
        """Write the open chunk, if anything is in it."""
        if not self._index:
            return
        buffer, compression = self._buffer, self._compression.encode()
        start_ns = min(min(times) for times, _ in self._index.values())
        end_ns = max(max(times) for times, _ in self._index.values())
        data = self._compress(buffer)
        head = struct.pack("<QQQII", start_ns, end_ns, len(buffer), zlib.crc32(buffer), len(compression))
        size = struct.pack("<Q", len(data))
        length = len(head) + len(compression) + len(size) + len(data)
        parts: list[Any] = [records.RECORD.pack(records.Op.CHUNK, length), head, compression, size, data]
        place = begin = self.written_bytes + records.RECORD_BYTES + length
        channels = {}
        for channel, (times, offsets) in self._index.items():
            pairs = np.array((times, offsets), dtype="<u8").T.tobytes()
            channels[channel] = place
            parts += [records.MESSAGE_INDEX.pack(_INDEX_OP, 6 + len(pairs), channel, len(pairs)), pairs]
            place += records.MESSAGE_INDEX.size + len(pairs)
            self.counts[channel] += len(times)
        self.start_ns = start_ns if not self._chunks else min(self.start_ns, start_ns)
        self.end_ns = max(self.end_ns, end_ns)
        index = records.ChunkIndex(
            chunk_length=begin - self.written_bytes,
            chunk_start_offset=self.written_bytes,
            compression=self._compression,
            compressed_size=len(data),
            message_end_time=end_ns,
            message_index_length=place - begin,
            message_index_offsets=channels,
            message_start_time=start_ns,
            uncompressed_size=len(buffer),
        )
        self._write_bytes(b"".join(parts))
        self._chunks.append(index)
        self._buffer = bytearray()
        self._index = {}
        self._opened_ns = None

    def attach(self, attachment: records.Attachment) -> None:
        """Add an attachment; it is in the file at once."""
        data, a = records.pack(attachment), attachment
        self._attachments.append(
            records.AttachmentIndex(
                self.written_bytes, len(data), a.log_time, a.create_time, len(a.data), a.name, a.media_type
            )
        )
        self._write_bytes(data)

    def add_metadata(self, metadata: records.Metadata) -> None:
        """Add a metadata record; it is in the file at once."""
        data = records.pack_metadata(metadata)
        self._metadata.append(records.MetadataIndex(self.written_bytes, len(data), metadata.name))
        self._write_bytes(data)

    def close(self) -> None:
        """Write the last chunk and the summary, and wait until the disk has them."""
        if self._file.closed:
            return
        self.close_chunk()
        self._write_bytes(records.pack(records.DataEnd(self._crc)))
        start = self.written_bytes
        statistics = records.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self.counts),
            channel_message_counts=self.counts,
            chunk_count=len(self._chunks),
            message_count=sum(self.counts.values()),
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups = [
            (records.Op.SCHEMA, list(self._schemas.values())),
            (records.Op.CHANNEL, [packed for _, packed in self._channels.values()]),
            (records.Op.STATISTICS, [records.pack(statistics)]),
            (records.Op.CHUNK_INDEX, [records.pack(chunk) for chunk in self._chunks]),
            (records.Op.ATTACHMENT_INDEX, [records.pack(index) for index in self._attachments]),
            (records.Op.METADATA_INDEX, [records.pack(index) for index in self._metadata]),
        ]
        summary = bytearray()
        offsets = b""
        for op, packed in groups:
            if packed:
                body = b"".join(packed)
                offsets += records.pack(records.SummaryOffset(op, start + len(summary), len(body)))
                summary += body
        offset_start = start + len(summary)
        summary += offsets
        summary += records.pack(records.Footer(start, offset_start, 0))[:-4]
        summary += struct.pack("<I", zlib.crc32(summary)) + records.MAGIC
        self._write_bytes(bytes(summary))
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Leave the file without a summary, as a crash would: it cannot be written any more."""
        self._file.close()

    def _define(self, channel: int) -> tuple[list[int], list[int]]:
        if channel not in self._channels:
            raise BagError(f"{self.path} has no channel {channel}: add it before writing to it")
        index: tuple[list[int], list[int]] = ([], [])
        self._index[channel] = index
        times = self._defined.get(channel, 0)
        if times < _DEFINED_TIMES:
            self._defined[channel] = times + 1
            schema, packed = self._channels[channel]
            self._buffer += self._schemas[schema] + packed
        return index

    def _write_bytes(self, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError as error:  # a full disk takes a part: what stays ends with a whole record
            with contextlib.suppress(OSError):
                self._file.truncate(self.written_bytes)
            raise OSError(error.errno, error.strerror, str(self.path)) from error
        self._crc = zlib.crc32(data, self._crc)
        self.written_bytes += len(data)
