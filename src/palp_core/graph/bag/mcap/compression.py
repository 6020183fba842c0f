"""Compress and decompress a chunk: zstd, lz4 or none."""

import threading
from collections.abc import Callable
from typing import Literal

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from palp_core.errors import BagError

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


class _OfThread(threading.local):
    """What decompresses in one thread: two at once would ruin each other's memory."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_OWN = _OfThread()


def decompress(name: str, data: bytes | memoryview, size: int) -> bytes:
    """Return a chunk's records; a ValueError if these are not such bytes, or of another size."""
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes is not plausible")
    try:
        if name == "zstd":
            if zstandard.frame_content_size(data) not in (-1, size):
                raise ValueError("two sizes in it contradict each other")
            records = _OWN.zstd.decompress(data, max_output_size=size)
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
