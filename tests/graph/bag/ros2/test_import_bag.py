"""A rosbag2, as rosbags writes it, becomes a bag of palp's and goes back as the same bytes."""

from __future__ import annotations

import os
import re
import resource
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType as McapCompression
from mcap.writer import Writer as FlatWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from palp_core.errors import BagError
from palp_core.graph.bag.forms import convert
from palp_core.graph.bag.info import bag_info
from palp_core.graph.bag.reader import Bag, read
from palp_core.graph.bag.ros2.import_bag import import_bag

STORE = get_typestore(Stores.ROS2_KILTED)
OWN = """\
int8 small
uint64 large
float32[3] three
string[] words
bool[] flags
int16[<=4] few
geometry_msgs/Point[] points
uint8[] raw
"""
LATCHED = Qos(
    QosHistory.KEEP_LAST, 3, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, QosTime(0, 0),
    QosTime(0, 0), QosLiveliness.AUTOMATIC, QosTime(0, 0), avoid_ros_namespace_conventions=False,
)  # fmt: skip
STORE.register(get_types_from_msg(OWN, "lab_msgs/msg/Own"))
T: Any = STORE.types


def wrench(i: int) -> Any:
    stamp = T["builtin_interfaces/msg/Time"](i // 1000, i % 1000 * 1_000_000)
    vector = T["geometry_msgs/msg/Vector3"]
    inner = T["geometry_msgs/msg/Wrench"](vector(0.0, -0.5, float("inf")), vector(1e-9, 0.0, i / 7))
    return T["geometry_msgs/msg/WrenchStamped"](T["std_msgs/msg/Header"](stamp, "probe é"), inner)


def own(i: int) -> Any:
    point = T["geometry_msgs/msg/Point"](1.0, 2.0, float(i))
    return T["lab_msgs/msg/Own"](
        -i, 2**64 - 1, np.array([0.1, i, 3], np.float32), ["a", ""], np.array([True, False]),
        np.array([-5, i], np.int16), [point] * (i % 3), np.frombuffer(bytes([255, i]), np.uint8),
    )  # fmt: skip


def recorded(folder: Path, plugin: StoragePlugin, count: int, compression: CompressionMode) -> Path:
    """A bag as ros2 writes it."""
    with_compression = Writer(folder, version=9, storage_plugin=plugin)
    if compression is not CompressionMode.NONE:
        with_compression.set_compression(compression, CompressionFormat.ZSTD)
    with with_compression as bag:
        topics = [
            ("/torque", "geometry_msgs/msg/WrenchStamped", wrench, [LATCHED]),
            ("/own", "lab_msgs/msg/Own", own, []),
            ("/empty", "std_msgs/msg/Empty", lambda _: T["std_msgs/msg/Empty"](), []),
        ]
        open_ = [
            (bag.add_connection(name, kind, typestore=STORE, offered_qos_profiles=qos), kind, make)
            for name, kind, make, qos in topics
        ]
        for i in range(count):
            for connection, kind, make in open_:
                bag.write(connection, 1_700_000_000_000_000_000 + i, STORE.serialize_cdr(make(i), kind))
    return folder


def raw(folder: Path) -> Iterator[tuple[Any, ...]]:
    """All that is in a rosbag2, but for how it is stored."""
    with Reader(folder) as bag:
        for connection, log_ns, data in bag.messages():
            qos = tuple(connection.ext.offered_qos_profiles)  # type: ignore[union-attr]
            yield connection.topic, connection.msgtype, connection.digest, qos, log_ns, bytes(data)


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("compression", [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_a_rosbag2_comes_back_byte_for_byte(
    tmp_path: Path, plugin: StoragePlugin, compression: CompressionMode
) -> None:
    if plugin is StoragePlugin.MCAP and compression is CompressionMode.MESSAGE:
        compression = CompressionMode.STORAGE  # MCAP compresses chunks itself
    source = recorded(tmp_path / "source", plugin, 20, compression)
    assert import_bag(source, tmp_path / "bag") == 60
    assert convert(tmp_path / "bag", tmp_path / "back", "ros2") == 60
    assert sorted(raw(tmp_path / "back")) == sorted(raw(source))


def test_what_came_is_read_as_any_bag(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", StoragePlugin.SQLITE3, 5, CompressionMode.NONE)
    import_bag(source, tmp_path / "bag")
    found = bag_info(tmp_path / "bag")
    assert found.complete
    assert found.healthy
    assert {name: (topic.type, topic.count) for name, topic in found.topics.items()} == {
        "/empty": ("Empty", 5),
        "/own": ("Own", 5),
        "/torque": ("WrenchStamped", 5),
    }
    with Bag(tmp_path / "bag") as bag:
        assert bag.topics()["/torque"].latched_depth == 3
    last: Any = list(read(tmp_path / "bag", ["/own"]))[-1].value
    assert (last.small, last.large, last.words, last.flags) == (-4, 2**64 - 1, ["a", ""], [True, False])
    assert last.three.tolist() == pytest.approx([0.1, 4.0, 3.0])
    assert (last.few, last.points[0].z, last.raw) == ([-5, 4], 4.0, b"\xff\x04")


def _spoken(name: str) -> Any:
    """Return what names the storage of a rosbag2 otherwise, in its metadata."""

    def spoil(source: Path) -> Path:
        file = source / "metadata.yaml"
        text, count = re.subn(r"storage_identifier: \S+", name, file.read_text())
        assert count == 1
        file.write_text(text)
        return source

    return spoil


def _with_a_copy(source: Path) -> Path:
    """Put a file of another storage, which metadata.yaml does not name, into a bag that names none."""
    (source / "source.db3").write_bytes(b"")
    changed: Path = _spoken("storage_identifier: ''")(source)
    return changed


def _fast(source: Path) -> Path:
    """Return a bag as ``ros2 bag record --storage-preset-profile fastwrite`` writes it: without chunks."""
    with Reader(source) as bag, (source / "flat").open("wb") as file:
        flat = FlatWriter(file, use_chunking=False, enable_crcs=False)
        flat.start("ros2", "libmcap")
        channels = {}
        for one in bag.connections:
            schema = flat.register_schema(one.msgtype, "ros2msg", one.msgdef.data.encode())
            channels[one.id] = flat.register_channel(one.topic, "cdr", schema, {"offered_qos_profiles": ""})
        (stored,) = bag.storage.storages  # type: ignore[attr-defined]
        for one, log_ns, data in stored.messages_scan(stored.connections):
            flat.add_message(channels[one.id], log_ns, data, log_ns)
        flat.finish()  # type: ignore[no-untyped-call]
    (source / "flat").replace(source / "source.mcap")
    return source / "source.mcap"


@pytest.mark.parametrize(
    ("plugin", "change"),
    [
        (StoragePlugin.MCAP, _spoken("storage_identifier: ''")),
        (StoragePlugin.SQLITE3, _spoken('storage_identifier: ""')),
        (StoragePlugin.SQLITE3, _spoken("storage_identifier:")),
        (StoragePlugin.MCAP, _with_a_copy),
        (StoragePlugin.MCAP, _fast),
        (StoragePlugin.SQLITE3, lambda source: source / "source.db3"),
    ],
)
def test_a_rosbag2_of_another_make_is_read(tmp_path: Path, plugin: StoragePlugin, change: Any) -> None:
    source = change(recorded(tmp_path / "source", plugin, 4, CompressionMode.NONE))
    assert import_bag(source, tmp_path / "bag") == 12
    assert import_bag(source, tmp_path / "chosen", select=lambda name: name != "/own") == 8


@pytest.mark.parametrize(
    ("plugin", "change"),
    [
        (StoragePlugin.MCAP, lambda source: source),
        (StoragePlugin.MCAP, _fast),
        (StoragePlugin.SQLITE3, lambda source: source),
    ],
)
def test_messages_stay_in_the_order_of_their_file_where_the_clock_went_back(
    tmp_path: Path, plugin: StoragePlugin, change: Any
) -> None:
    times, kind = [5_000_000_000, 6_000_000_000, 1, 2, 7_000_000_000], "std_msgs/msg/Empty"
    with Writer(tmp_path / "source", version=9, storage_plugin=plugin) as bag:
        topics = [bag.add_connection(name, kind, typestore=STORE) for name in ("/a", "/b")]
        for place, time_ns in enumerate(times):
            data = STORE.serialize_cdr(T[kind](), kind)
            bag.write(topics[place % 2], time_ns, data)
    assert import_bag(change(tmp_path / "source"), tmp_path / "bag") == 5
    assert [message.log_ns for message in read(tmp_path / "bag")] == times
    found = bag_info(tmp_path / "bag")
    assert (found.backward_count, found.backward_s) == (1, 5.999999999)


def _cut(source: Path) -> Path:
    file = source / "source.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    return source


def _not_utf_8(source: Path) -> Path:
    file = source / "source.mcap"
    file.write_bytes(file.read_bytes().replace("probe é".encode(), b"probe \xff\xff"))
    return source


def _pipe(source: Path) -> Path:
    (source / "source.mcap").unlink()
    os.mkfifo(source / "source.mcap")
    return source


def _unknown(source: Path) -> Path:
    (source / "metadata.yaml").unlink()
    return source


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_cut, "cannot be read as a rosbag2"),
        (_unknown, r"no metadata.yaml is in it; give one of its files: source.mcap"),
        (lambda source: source / "none", "no such bag"),
        (_spoken("storage_identifier: rocksdb"), "cannot be read as a rosbag2: ReaderError: .*'rocksdb'"),
        (_spoken("other: ''"), "cannot be read as a rosbag2: ReaderError: .*'storage_identifier'"),
        (_pipe, "cannot be read as a rosbag2: it is a pipe"),
        (_not_utf_8, "/torque, message 1 at [0-9]+ ns: no geometry_msgs/msg/WrenchStamped: SerdeError"),
    ],
)
def test_what_cannot_be_read_is_an_error_with_its_reason(tmp_path: Path, spoil: Any, words: str) -> None:
    source = recorded(tmp_path / "source", StoragePlugin.MCAP, 3, CompressionMode.NONE)
    with pytest.raises(BagError, match=words):
        import_bag(spoil(source), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


LARGE_BYTES = 32 << 20


def _mcap_of_zeros(folder: Path, compression: McapCompression) -> Path:
    with (folder / "zeros.mcap").open("wb") as file:
        bag = FlatWriter(file, compression=compression)
        bag.start(profile="ros2")
        schema = bag.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = bag.register_channel("/zeros", "cdr", schema)
        bag.add_message(channel, 1, bytes(LARGE_BYTES), 1)
        bag.finish()  # type: ignore[no-untyped-call]
    return folder / "zeros.mcap"


def _rosbag_of_zeros(folder: Path, compression: CompressionMode) -> Path:
    kind = "std_msgs/msg/String"
    bag = Writer(folder / "zeros", version=9, storage_plugin=StoragePlugin.SQLITE3)
    bag.set_compression(compression, CompressionFormat.ZSTD)
    with bag:
        bag.write(bag.add_connection("/zeros", kind, typestore=STORE), 1, bytes(LARGE_BYTES))
    return folder / "zeros"


@pytest.mark.parametrize(
    ("write", "compression"),
    [
        (_mcap_of_zeros, McapCompression.ZSTD),
        (_mcap_of_zeros, McapCompression.LZ4),
        (_rosbag_of_zeros, CompressionMode.FILE),
        (_rosbag_of_zeros, CompressionMode.MESSAGE),
    ],
)
def test_a_small_file_that_becomes_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Any, compression: Any
) -> None:
    monkeypatch.setattr(import_module("palp_core.graph.bag.ros2.import_bag"), "SMALLEST_BOUND_BYTES", 1 << 20)
    monkeypatch.setattr(import_module("palp_core.graph.bag.ros2.import_bag"), "MOST_TIMES", 100)
    source = write(tmp_path, compression)
    with pytest.raises(
        BagError, match=r"zeros(\.mcap)?: decompressed it has more than [0-9]+ MiB; record it"
    ):
        import_bag(source, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


LINE = "=" * 80
BOUNDLESS = {
    "itself": ("Own[] own", "holds itself"),
    "deep": ("T0 t" + "".join(f"\n{LINE}\nMSG: lab_msgs/T{n}\nT{n + 1} t" for n in range(1500))
             + f"\n{LINE}\nMSG: lab_msgs/T1500\nint8 x", "more than 32 deep"),
    "wide": ("T0 t" + "".join(f"\n{LINE}\nMSG: lab_msgs/T{n}\nT{n + 1} a\nT{n + 1} b" for n in range(30))
             + f"\n{LINE}\nMSG: lab_msgs/T30\nint8 x", "fields, its parts' included"),
    "long": ("float64[1000000000000000000] x", "palp reads no float64.1000000000000000000"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BOUNDLESS)
def test_a_type_beyond_bounds_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    text, words = BOUNDLESS[kind]
    with (tmp_path / "bag.mcap").open("wb") as file:
        bag = FlatWriter(file)
        bag.start(profile="ros2")
        schema = bag.register_schema("lab_msgs/msg/Own", "ros2msg", text.encode())
        channel = bag.register_channel("/own", "cdr", schema)
        bag.add_message(channel, 1, b"\0\1\0\0" + b"\xff" * 64, 1)
        bag.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(BagError, match=f"/own.*{words}"):
        import_bag(tmp_path / "bag.mcap", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_type_without_a_definition_is_named(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", StoragePlugin.SQLITE3, 1, CompressionMode.NONE)
    import sqlite3

    with sqlite3.connect(source / "source.db3") as base:
        base.execute("DELETE FROM message_definitions")
    with pytest.raises(BagError, match=r"/own: the bag does not define lab_msgs/msg/Own.*-x REGEX"):
        import_bag(source, tmp_path / "bag")
    assert import_bag(source, tmp_path / "bag", select=lambda name: name != "/own") == 2


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("plugin", "minutes"), [(StoragePlugin.MCAP, 60), (StoragePlugin.SQLITE3, 10)], ids=str
)
def test_an_hour_at_1_khz_comes_back_equal_in_bounded_memory(
    tmp_path: Path, plugin: StoragePlugin, minutes: int
) -> None:
    kind, count = "geometry_msgs/msg/WrenchStamped", minutes * 60_000
    payloads = [bytes(STORE.serialize_cdr(wrench(i), kind)) for i in range(1000)]
    with Writer(tmp_path / "source", version=9, storage_plugin=plugin) as bag:
        connection = bag.add_connection("/torque", kind, typestore=STORE)
        for i in range(count):
            bag.write(connection, i * 1_000_000, payloads[i % 1000])
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert import_bag(tmp_path / "source", tmp_path / "bag") == count
    assert convert(tmp_path / "bag", tmp_path / "back", "ros2") == count
    with Reader(tmp_path / "back") as back:
        for i, (_, log_ns, data) in enumerate(back.messages()):
            assert (log_ns, data) == (i * 1_000_000, payloads[i % 1000])
        assert back.message_count == count
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < 300 << 10
