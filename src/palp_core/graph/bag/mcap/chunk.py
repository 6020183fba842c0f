"""A chunk: compressed, decompressed, and taken apart after its CRC."""

import struct
import zlib
from collections.abc import Callable
from typing import Literal

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from palp_core.errors import BagError
from palp_core.graph.bag.mcap.records import (
    LIBRARY,
    MAGIC,
    MESSAGE,
    MESSAGE_BYTES,
    RECORD,
    RECORD_BYTES,
    ChunkIndex,
    Header,
    Op,
    parse,
)

RawMessage = tuple[int, int, int, int, bytes]
"""Channel, sequence, log time, publish time, payload."""
ChunkHead = tuple[int, int, int, int, str, memoryview]
"""First and last log time, size and CRC of the uncompressed records, compression, what is stored."""

MESSAGE_OP, DEFINITIONS = int(Op.MESSAGE), (int(Op.SCHEMA), int(Op.CHANNEL))
_NUMBERS = struct.Struct("<BQQQQII")
_SIZE = struct.Struct("<Q")

Compression = Literal["zstd", "lz4", "none"]
COMPRESSIONS: tuple[Compression, ...] = ("zstd", "lz4", "none")
MAX_CHUNK_BYTES = 1 << 30
"""A chunk that claims more when decompressed is taken as damaged."""


def compressor(name: Compression) -> tuple[str, Callable[[bytes | bytearray], bytes | bytearray]]:
    """Return the name that the format has for a compression, and the function that does it."""
    if name == "zstd":
        return "zstd", zstandard.ZstdCompressor(level=1, write_checksum=False).compress
    if name == "lz4":
        return "lz4", lz4.frame.compress
    if name == "none":
        return "", lambda data: data
    raise BagError(f"unknown compression '{name}'; use one of {', '.join(COMPRESSIONS)}")


def decompress(name: str, data: bytes | memoryview, size: int) -> bytes:
    """Return a chunk's records; a ValueError if these are not such bytes, or of another size."""
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes is not plausible")
    try:
        if name == "zstd":
            if zstandard.frame_content_size(data) not in (-1, size):
                raise ValueError("two sizes in it contradict each other")
            records = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        elif name == "lz4":
            lz4_frame = lz4.frame.LZ4FrameDecompressor()
            records = lz4_frame.decompress(data, max_length=size)
            if not lz4_frame.eof:
                raise ValueError(f"it decompresses to more than {size} bytes, or ends early")
        elif name == "":
            records = bytes(data)
        else:
            raise ValueError(f"unknown compression '{name}'")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise ValueError(f"{name} cannot decompress it: {error}") from error
    if len(records) != size:
        raise ValueError(f"it decompresses to {len(records)} bytes, not {size}")
    return records


def read_chunk_head(data: bytes | memoryview, *, torn: bool = False) -> ChunkHead:
    """Split a chunk's whole record into its fields; of a torn one, take what is there.

    A record that is no chunk is a ValueError or a struct.error.
    """
    op, length, start_ns, end_ns, size, crc, name_bytes = _NUMBERS.unpack_from(data)
    if op != Op.CHUNK:
        raise ValueError(f"record {op} is not a chunk")
    name_end = _NUMBERS.size + name_bytes
    (stored_bytes,) = _SIZE.unpack_from(data, name_end)
    begin = name_end + _SIZE.size
    if begin - RECORD_BYTES + stored_bytes != length:
        raise ValueError("its lengths contradict each other")
    stored = memoryview(data)[begin : begin + stored_bytes]
    if len(stored) != stored_bytes and not torn:
        raise ValueError(f"{stored_bytes} bytes expected, {len(stored)} left")
    return start_ns, end_ns, size, crc, str(data[_NUMBERS.size : name_end], "utf-8"), stored


def made_by_palp(start: bytes) -> bool:
    """Tell from a file's first bytes whether palp wrote it: each of its chunks has a CRC.

    In another's file a CRC of 0 means that there is none.
    """
    begin = len(MAGIC) + RECORD_BYTES
    if start[: len(MAGIC)] != MAGIC or start[len(MAGIC) : len(MAGIC) + 1] != bytes([Op.HEADER]):
        return False
    try:
        return bool(parse(Header, start[begin:]).library == LIBRARY)
    except ValueError:
        return False


def open_chunk(data: bytes | memoryview, index: ChunkIndex | None = None, *, has_crc: bool = False) -> bytes:
    """Return the records of a chunk, given its whole record; a ValueError if it is not what was written.

    ``index`` is its entry in a checked summary, which it must match. With ``has_crc`` a CRC of 0 is one, too;
    else that means that there is none.
    """
    start_ns, end_ns, size, crc, compression, stored = read_chunk_head(data)
    if index is not None:
        length = _NUMBERS.size + len(compression) + _SIZE.size + len(stored)
        if (length, start_ns, end_ns, size, compression, len(stored)) != (
            index.chunk_length,
            index.message_start_time,
            index.message_end_time,
            index.uncompressed_size,
            index.compression,
            index.compressed_size,
        ):
            raise ValueError("it is not the chunk that the summary describes")
    records = decompress(compression, stored, size)
    if (crc or has_crc) and zlib.crc32(records) != crc:
        raise ValueError("the CRC does not match")
    return records


def split_chunk(
    records: bytes, define: Callable[[int, memoryview], None], *, torn: bool = False
) -> list[RawMessage]:
    """Return the messages of a chunk in order; opcode and content of each definition go to ``define``.

    Of a ``torn`` chunk an incomplete last record is left out; else it is a ValueError, as is what makes no
    sense.
    """
    messages: list[RawMessage] = []
    append, unpack = messages.append, MESSAGE.unpack_from
    offset, size = 0, len(records)
    try:
        while offset < size:
            if records[offset] == MESSAGE_OP:
                _, length, channel, sequence, log_ns, publish_ns = unpack(records, offset)
                begin = offset + MESSAGE_BYTES
                offset += RECORD_BYTES + length
                if offset > size:
                    break
                if offset < begin:
                    raise ValueError("a message is shorter than its head")
                append((channel, sequence, log_ns, publish_ns, records[begin:offset]))
            else:
                op, length = RECORD.unpack_from(records, offset)
                begin = offset + RECORD_BYTES
                offset = begin + length
                if offset > size:
                    break
                if op in DEFINITIONS:
                    define(op, memoryview(records)[begin:offset])
                elif op == 0:
                    raise ValueError("record 0")
    except struct.error as error:
        if not torn:
            raise ValueError(str(error)) from error
    if offset != size and not torn:
        raise ValueError("its last record is not whole")
    return messages
