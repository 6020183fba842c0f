"""Make a palp bag of a recording of ROS 2's (rosbag2: MCAP or SQLite), read through ``rosbags``.

A topic's messages become maps by their definitions. The topic's schema keeps their type, definition and
quality of service in ROS 2, so that the way back gives the same bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import msgspec

from palp_core.errors import BagError
from palp_core.foreign import catch_foreign, describe_foreign
from palp_core.graph.bag.metadata import named_files
from palp_core.graph.bag.ros2.definitions import ROS2_KEY, Definitions, empty, json_schema, standard
from palp_core.graph.bag.ros2.values import reader as message_reader
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter, whole_folder
from palp_core.graph.messages.topic import Topic
from palp_core.whole_file import check_regular

_STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
RATHER = "leave it out with -x REGEX"
_MEND = "if its MCAP is cut off: palp bag recover BAG -o NEW, then convert NEW"

SMALLEST_BOUND_BYTES, MOST_TIMES = 1 << 30, 1000
"""Bound of a decompressed bag (assumed): so many times its size, 1 GiB at least."""


def import_bag(bag: str | Path, out: str | Path, *, select: Callable[[str], bool] | None = None) -> int:
    """Write a rosbag2 as a palp bag.

    Log times are kept, and messages come as they were recorded, even where the clock went back; a message's
    time of publication, which rosbag2 lacks, is its log time.
    """
    bag = Path(bag)
    with whole_folder(out) as folder, _opened(bag) as source:
        chosen = [one for one in source.connections if select is None or select(one.topic)]
        with BagWriter(folder, custom={"made_of": bag.name}) as writer:
            return _copy(bag, source, chosen, writer)


def _copy(bag: Path, source: Any, chosen: list[Any], writer: BagWriter) -> int:
    encode = msgspec.msgpack.Encoder().encode
    definitions, known = empty(), standard()
    streams = {}
    for one in chosen:
        with _named(bag, one.topic):
            _define(definitions, known, one)
            stream = writer.stream(Stream(topic=_topic(one, definitions)))
            streams[one.id] = stream, message_reader(definitions, one.msgtype)
    counts = Counter[str]()
    for connection, log_ns, data in _messages(bag, source, chosen):
        topic, (stream, read) = connection.topic, streams[connection.id]
        counts[topic] += 1
        with _named(bag, f"{topic}, message {counts[topic]} at {log_ns} ns"):
            payload = encode(read(data))
            if log_ns < 0:
                raise BagError("its time is before 1970")
        writer.write(stream, counts[topic], log_ns, log_ns, payload)
    count, expected = counts.total(), sum(one.msgcount for one in chosen)
    if count < expected:
        raise BagError(
            f"{bag} is not whole: {count} of {expected} messages can be read; `ros2 bag reindex` it"
        )
    return count


def _messages(bag: Path, source: Any, chosen: list[Any]) -> Iterator[tuple[Any, int, bytes]]:
    """Yield the messages of the chosen topics; what rosbags finds wrong meanwhile becomes a BagError."""
    if not chosen:
        return
    try:
        yield from source.messages(connections=chosen)
    except BagError:
        raise
    except Exception as error:  # rosbags' storages each have their own
        raise BagError(
            f"{bag} cannot be read on: {describe_foreign(error)}; try `ros2 bag reindex` or `mcap sort`"
        ) from error


def _topic(connection: Any, definitions: Definitions) -> Topic:
    name, profiles = connection.msgtype, connection.ext.offered_qos_profiles or []
    schema = json_schema(definitions, name)
    schema[ROS2_KEY] = {
        "type": name,
        "definition": definitions.text(name),
        "qos": [{key: _plain(value) for key, value in one._asdict().items()} for one in profiles],
    }
    latched = [max(one.depth, 1) for one in profiles if one.durability.name == "TRANSIENT_LOCAL"]
    return Topic(
        name=connection.topic,
        type=name.rpartition("/")[2],
        json_schema=schema,
        latched_depth=max(latched, default=0),
    )


def _plain(value: Any) -> Any:
    return value.name if hasattr(value, "name") else list(value) if isinstance(value, tuple) else value


@contextmanager
def _named(bag: Path, what: str) -> Iterator[None]:
    """Begin an error with the topic that it is about."""
    try:
        yield
    except BagError as error:
        raise BagError(f"{bag}: {what}: {error}; {RATHER}") from error


def _define(found: Definitions, known: Definitions, connection: Any) -> None:
    """Add the type of a topic: as the bag defines it, else as ROS 2 does."""
    serialization = connection.ext.serialization_format
    if serialization not in ("cdr", ""):
        advice = "; a palp bag needs no conversion" if serialization == "msgpack" else ""
        raise BagError(f"it is in {serialization}, not cdr{advice}")
    name, (form, text) = connection.msgtype, connection.msgdef
    if form.name == "MSG":
        found.add({name: text})
    elif form.name == "IDL":
        found.take(_idl_types(text))
    elif name in known:
        found.add({name: known.text(name)})
    else:
        raise BagError(f"the bag does not define {name}, and it is not one of ROS 2's own types")
    if name not in found:
        raise BagError(f"the bag's definition of {name} defines another type")


def _idl_types(text: str) -> dict[str, Any]:
    """Return the types of IDL text; several are apart as in MCAP files."""
    from rosbags.typesys import get_types_from_idl

    found: dict[str, Any] = {}
    line = "=" * 80 + "\n"
    parts = [part.partition("\n")[2] for part in text.split(line)[1:]] if text.startswith(line) else [text]
    for part in parts:
        with catch_foreign("its definition cannot be read", BagError):
            found |= get_types_from_idl(part)
    return found


@contextmanager
def _opened(bag: Path) -> Iterator[Any]:
    """Open a rosbag2; a file is a bag of itself."""
    from rosbags.rosbag2 import Reader

    if not bag.exists():
        raise BagError(f"{bag}: no such bag; give a rosbag2's folder, an .mcap or a .db3 file")
    if bag.is_dir() and not (bag / "metadata.yaml").exists():
        held = sorted(path.name for path in bag.iterdir() if path.suffix in _STORAGES)
        advice = f"give one of its files: {', '.join(held[:3])}" if held else "give a rosbag2's folder"
        raise BagError(f"{bag}: no metadata.yaml is in it; {advice}")
    with _BoundedDecompression(bag):
        with catch_foreign(f"{bag} cannot be read as a rosbag2", BagError, _MEND):
            for path in _files(bag):
                check_regular(path)
            source = Reader(bag)
            if bag.is_dir():
                _take_empty_identifier(bag, source.storage)
            source.open()
            for one in getattr(source.storage, "storages", [source.storage]):
                _read_as_recorded(one)
        try:
            yield source
        finally:
            source.close()


def _read_as_recorded(storage: Any) -> None:
    """Have rosbags, which orders messages by time, read them as they come in their file."""
    if hasattr(storage, "messages_scan"):
        storage.messages = storage.messages_scan
    else:
        base, order, rather = storage.dbconn, "ORDER BY timestamp", "ORDER BY messages.id"
        storage.dbconn = SimpleNamespace(
            close=base.close, execute=lambda text, values: base.execute(text.replace(order, rather), values)
        )


def _files(bag: Path) -> list[Path]:
    kinds = (*_STORAGES, ".yaml", ".zstd")
    return [path for path in (bag.iterdir() if bag.is_dir() else [bag]) if path.suffix in kinds]


class _BoundedDecompression:
    """Has rosbags, which has no bound of its own, decompress a bag until it becomes too large."""

    def __init__(self, bag: Path) -> None:
        from rosbags.rosbag2 import reader, storage_mcap

        self._reader: Any = reader
        self._chunks, self._chunks_before = storage_mcap.DECOMPRESSORS, dict(storage_mcap.DECOMPRESSORS)
        self._bag, self._zstd = bag, self._reader.zstd
        size = sum(path.stat().st_size for path in _files(bag) if path.is_file())
        self._bound = self._left = max(SMALLEST_BOUND_BYTES, MOST_TIMES * size)

    def __enter__(self) -> None:
        self._reader.zstd = SimpleNamespace(open=self._open_zstd, decompress=self._decompress_zstd)
        self._chunks.update(zstd=self._decompress_zstd, lz4=self._decompress_lz4)

    def __exit__(self, *_: object) -> None:
        self._reader.zstd = self._zstd
        self._chunks.update(self._chunks_before)

    def _counted(self, data: bytes) -> bytes:
        self._left -= len(data)
        if self._left < 0:
            raise BagError(
                f"{self._bag}: decompressed it has more than {self._bound >> 20} MiB; "
                "record it in parts, or decompress it with `zstd -d` or `mcap decompress`"
            )
        return data

    def _decompress_zstd(self, data: bytes, _size: int = 0) -> bytes:
        return self._counted(self._zstd.ZstdDecompressor().decompress(data, self._left + 1))

    def _decompress_lz4(self, data: bytes, _size: int) -> bytes:
        return self._counted(lz4.frame.LZ4FrameDecompressor().decompress(data, self._left + 1))

    @contextmanager
    def _open_zstd(self, file: BinaryIO, _mode: str) -> Iterator[SimpleNamespace]:
        with self._zstd.open(file, "rb") as opened:
            yield SimpleNamespace(read=lambda size: self._counted(opened.read(size)))


def _take_empty_identifier(bag: Path, storage: Any) -> None:
    """Take the storage from the names of the files in ``metadata.yaml`` where it names no storage."""
    suffixes = {suffix for name in named_files(bag) for suffix in Path(name).suffixes if suffix in _STORAGES}
    if len(suffixes) == 1:
        plugin = storage.STORAGE_PLUGINS[_STORAGES[suffixes.pop()]]
        storage.STORAGE_PLUGINS = {**storage.STORAGE_PLUGINS, "": plugin, None: plugin}
