"""Make a palp bag of a recording of ROS 2's (rosbag2: MCAP or SQLite), read through ``rosbags``.

A topic's messages become maps by their definitions. The topic's schema keeps their type, definition and
quality of service in ROS 2, so that the way back gives the same bytes.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import msgspec

from palp_core.errors import BagError
from palp_core.extras import install_line
from palp_core.foreign import catch_foreign, describe_foreign
from palp_core.graph.bag.ros2.definitions import ROS2_KEY, Definitions, empty, json_schema, standard
from palp_core.graph.bag.ros2.values import reader as message_reader
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.topic import Topic
from palp_core.whole_file import check_regular

_STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
RATHER = "leave it out with -x REGEX"

SMALLEST_BOUND_BYTES, MOST_TIMES = 1 << 30, 1000
"""Bound of a decompressed bag (assumed): so many times its size, 1 GiB at least."""


class _Way(NamedTuple):
    stream: int
    read: Callable[[bytes], dict[str, Any]]


def import_bag(bag: str | Path, out: str | Path, *, select: Callable[[str], bool] | None = None) -> int:
    """Write a rosbag2 as a palp bag.

    Log times are kept; a message's time of publication, which rosbag2 lacks, is its log time.

    Args:
        bag: Folder of a rosbag2, or one of its files (``.mcap``, ``.db3``).
        out: The new bag, which must not exist.
        select: Returns whether to keep a topic; None: all.

    Returns:
        How many messages there are.

    Raises:
        BagError: rosbags is not installed, there is no such bag, it is damaged, a type is not known or is not
            ROS 2's, or the new bag exists.
    """
    if Path(out).exists():
        raise BagError(f"{out} exists already: choose another name")
    with _opened(Path(bag)) as source:
        chosen = [one for one in source.connections if select is None or select(one.topic)]
        definitions = _definitions(Path(bag), chosen)
        try:
            with BagWriter(out, custom={"made_of": Path(bag).name}) as writer:
                count = _copy(Path(bag), source, chosen, definitions, writer)
            _check_whole(Path(bag), chosen, count)
        except BagError:
            shutil.rmtree(out, ignore_errors=True)  # half a bag is of no use
            raise
    return count


def _check_whole(bag: Path, chosen: list[Any], count: int) -> None:
    expected = sum(one.msgcount for one in chosen)
    if count < expected:
        raise BagError(
            f"{bag} is not whole: {count} of {expected} messages can be read; `ros2 bag reindex` it"
        )


def _copy(bag: Path, source: Any, chosen: list[Any], definitions: Definitions, writer: BagWriter) -> int:
    encode = msgspec.msgpack.Encoder().encode
    ways = {}
    for one in chosen:
        with _named(bag, one.topic):
            ways[one.id] = _way(one, definitions, writer)
    sequences = dict.fromkeys((one.topic for one in chosen), 0)
    count = 0
    for connection, log_ns, data in _messages(bag, source, chosen):
        way, topic = ways[connection.id], connection.topic
        sequences[topic] += 1
        try:
            payload = encode(way.read(data))
        except BagError as error:
            raise BagError(
                f"{bag}: {topic}, message {sequences[topic]} at {log_ns} ns: {error}; {RATHER}"
            ) from error
        if log_ns < 0:
            raise BagError(f"{bag}: {topic}, message {sequences[topic]}: its time {log_ns} ns is before 1970")
        writer.write(way.stream, sequences[topic], log_ns, log_ns, payload)
        count += 1
    return count


def _messages(bag: Path, source: Any, chosen: list[Any]) -> Iterator[tuple[Any, int, bytes]]:
    """Yield what the chosen topics carry; what rosbags finds wrong meanwhile becomes a BagError."""
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


def _way(connection: Any, definitions: Definitions, writer: BagWriter) -> _Way:
    name = connection.msgtype
    schema = json_schema(definitions, name)
    schema[ROS2_KEY] = {
        "type": name,
        "definition": definitions.text(name),
        "qos": _qos_text(connection.ext.offered_qos_profiles),
    }
    title = name.rpartition("/")[2]
    topic = Topic(
        name=connection.topic,
        type=title,
        json_schema=schema,
        latched_depth=_latched_depth(connection.ext.offered_qos_profiles),
    )
    return _Way(writer.stream(Stream(topic=topic)), message_reader(definitions, name))


def _qos_text(profiles: Any) -> list[dict[str, Any]]:
    """Return the profiles that publishers offered, as plain values by rosbags' names."""
    return [
        {
            key: value.name if hasattr(value, "name") else list(value) if isinstance(value, tuple) else value
            for key, value in profile._asdict().items()
        }
        for profile in profiles or []
    ]


def _latched_depth(profiles: Any) -> int:
    """Return how many last messages a late reader is owed: those of transient local publishers."""
    return max((max(p.depth, 1) for p in profiles or [] if p.durability.name == "TRANSIENT_LOCAL"), default=0)


def _definitions(bag: Path, connections: list[Any]) -> Definitions:
    """Return the types of all topics: as the bag defines them, else as ROS 2 does."""
    found = empty()
    known = standard()
    for one in connections:
        if one.ext.serialization_format not in ("cdr", ""):
            raise BagError(
                f"{bag}: {one.topic} is in {one.ext.serialization_format}, not cdr; {RATHER}"
                + ("; a palp bag needs no conversion" if one.ext.serialization_format == "msgpack" else "")
            )
        with _named(bag, one.topic):
            _define(found, known, one)
    return found


@contextmanager
def _named(bag: Path, topic: str) -> Iterator[None]:
    """Begin an error with the topic whose type it is about."""
    try:
        yield
    except BagError as error:
        raise BagError(f"{bag}: {topic}: {error}; {RATHER}") from error


def _define(found: Definitions, known: Definitions, connection: Any) -> None:
    name, (form, text) = connection.msgtype, connection.msgdef
    if form.name == "MSG":
        found.add({name: text})
    elif form.name == "IDL":
        found.take(_idl_types(text))
    elif name in known:
        found.add({name: known.text(name)})
    else:
        raise BagError(f"the bag does not define {name}, which is none of ROS 2's own types")
    if name not in found:
        raise BagError(f"the bag's definition of {name} is of another type")


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
    """Open a rosbag2; a file is a bag of itself.

    Raises:
        BagError: rosbags is not installed, or it cannot open this.
    """
    try:
        from rosbags.rosbag2 import Reader
    except ImportError as error:
        raise BagError(f"ROS 2's bags need rosbags: {install_line('rosbag')}") from error
    if not bag.exists():
        raise BagError(f"{bag}: no such bag; give a rosbag2's folder, an .mcap or a .db3 file")
    if bag.is_dir() and not (bag / "metadata.yaml").exists():
        held = sorted(path.name for path in bag.iterdir() if path.suffix in _STORAGES)
        advice = f"give one of its files: {', '.join(held[:3])}" if held else "give a rosbag2's folder"
        raise BagError(f"{bag}: no metadata.yaml is in it; {advice}")
    with _bounded_decompression(bag):
        with catch_foreign(f"{bag} cannot be read as a rosbag2", BagError):
            for path in _files(bag):
                check_regular(path)
            source = Reader(bag)
            if bag.is_dir():
                _take_empty_identifier(bag, source.storage)
            source.open()
        try:
            yield source
        finally:
            source.close()


def _files(bag: Path) -> list[Path]:
    kinds = (*_STORAGES, ".yaml", ".zstd")
    return [path for path in (bag.iterdir() if bag.is_dir() else [bag]) if path.suffix in kinds]


class _Decompression:
    """Decompresses what a bag holds until it has become too large.

    Args:
        bag: A folder or a file.
        zstd: The module that rosbags decompresses with.
    """

    def __init__(self, bag: Path, zstd: Any) -> None:
        size = sum(path.stat().st_size for path in _files(bag) if path.is_file())
        self._bag, self._zstd = bag, zstd
        self._bound = self._left = max(SMALLEST_BOUND_BYTES, MOST_TIMES * size)

    def _counted(self, data: bytes) -> bytes:
        self._left -= len(data)
        if self._left < 0:
            raise BagError(
                f"{self._bag}: decompressed it has more than {self._bound >> 20} MiB; "
                "record it in parts, or decompress it with `zstd -d` or `mcap decompress`"
            )
        return data

    def zstd(self, data: bytes, _size: int = 0) -> bytes:
        return self._counted(self._zstd.ZstdDecompressor().decompress(data, self._left + 1))

    def lz4(self, data: bytes, _size: int) -> bytes:
        found: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, self._left + 1)
        return self._counted(found)

    @contextmanager
    def open(self, file: BinaryIO, _mode: str) -> Iterator[SimpleNamespace]:
        with self._zstd.open(file, "rb") as opened:
            yield SimpleNamespace(read=lambda size: self._counted(opened.read(size)))


@contextmanager
def _bounded_decompression(bag: Path) -> Iterator[None]:
    """Have rosbags, which has no bound of its own, decompress within one.

    Args:
        bag: A folder or a file.
    """
    from rosbags.rosbag2 import reader, storage_mcap

    files: Any = reader
    zstd, decompressors = files.zstd, dict(storage_mcap.DECOMPRESSORS)
    bounded = _Decompression(bag, zstd)
    files.zstd = SimpleNamespace(open=bounded.open, decompress=bounded.zstd)
    storage_mcap.DECOMPRESSORS.update(zstd=bounded.zstd, lz4=bounded.lz4)
    try:
        yield
    finally:
        files.zstd = zstd
        storage_mcap.DECOMPRESSORS.update(decompressors)


def _take_empty_identifier(bag: Path, storage: Any) -> None:
    """Take the storage from the files' names where ``storage_identifier`` is empty."""
    suffixes = {suffix for path in bag.iterdir() for suffix in path.suffixes if suffix in _STORAGES}
    if len(suffixes) == 1:
        plugin = storage.STORAGE_PLUGINS[_STORAGES[suffixes.pop()]]
        storage.STORAGE_PLUGINS = {**storage.STORAGE_PLUGINS, "": plugin}
