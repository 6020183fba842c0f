import io
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from palp_core.errors import BagDamaged, BagError
from palp_core.graph.bag.mcap.chunk import RawMessage
from palp_core.graph.bag.mcap.file_reader import ChunkPlace
from palp_core.graph.bag.reader import Bag, read, to_numpy
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode


def test_values_are_the_messages_without_their_classes(bag: Path, kit: Any) -> None:
    sent = [parse(raw) for _, raw in kit.run_frames(200)]
    for wire, message in zip(sent, read(bag), strict=True):
        original = decode(kit.Block if wire.topic == "/torque/block" else kit.Mode, wire.payload)
        assert message.value.stamp_ns == original.stamp_ns
        if wire.topic == "/torque/block":
            assert message.value.torque_n_m.tobytes() == original.torque_n_m.tobytes()
            assert message.value.torque_n_m.flags.aligned
            assert message.value.place.depth_m == original.place.depth_m
            assert message.value.counts == original.counts


def test_topics_and_times_select_messages(bag: Path) -> None:
    found = list(read(bag, ["/torque/block"], start_ns=50_000_000, end_ns=60_000_000))
    assert [m.sequence for m in found] == list(range(51, 61))
    assert [m.sequence for m in read(bag, ["/policy/mode"])] == [1, 2]
    assert list(read(bag, end_ns=0)) == []


def test_a_window_reads_only_its_chunks(bag: Path) -> None:
    with Bag(bag) as opened:
        (file,) = opened.files
        opened_at: list[int] = []
        read_chunk = file.read_chunk

        def spy(place: ChunkPlace) -> list[RawMessage]:
            opened_at.append(place.offset)
            return read_chunk(place)

        file.read_chunk = spy  # type: ignore[method-assign]
        assert sum(1 for _ in opened.recorded(None, 100_000_000, 101_000_000)) == 2
        assert len(opened_at) < len(file.chunks) / 3
        opened_at.clear()
        assert sum(1 for _ in opened.recorded(["/policy/mode"])) == 2
        assert len(opened_at) == 2


def test_a_single_file_is_a_bag(bag: Path) -> None:
    assert sum(1 for _ in read(bag / "run_0.mcap")) == 202


def test_fields_come_as_arrays(bag: Path) -> None:
    torque_n_m = to_numpy(bag, "/torque/block", "torque_n_m")
    assert torque_n_m.shape == (200, 4)
    assert to_numpy(bag, "/torque/block", "stamp_ns").tolist() == [i * 1_000_000 for i in range(200)]
    assert to_numpy(bag, "/torque/block", "place.depth_m").tolist() == [0.0] * 200
    assert to_numpy(bag, "/torque/block", "sequence")[-1] == 200
    assert to_numpy(bag, "/policy/mode", "level").tolist() == [0.5, 1.5]


def test_arrays_of_different_lengths_follow_each_other(tmp_path: Path, kit: Any) -> None:
    blocks = [kit.Block(stamp_ns=0, torque_n_m=np.arange(float(n))) for n in (2, 3)]
    frames = [(0, kit.frame("/torque/block", b, i + 1, 0)) for i, b in enumerate(blocks)]
    bag, _ = kit.record(tmp_path / "run", frames)
    assert to_numpy(bag, "/torque/block", "torque_n_m").tolist() == [0.0, 1.0, 0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda bag: list(read(bag, ["/torque/blok"])), "it has: /policy/mode, /torque/block"),
        (lambda bag: to_numpy(bag, "/torque/block", "torque"), "no field 'torque'; it has: stamp_ns"),
        (lambda bag: to_numpy(bag, "/torque/block", "place"), "neither a number nor text"),
        (lambda bag: list(read(bag / "nothing")), "no such bag"),
    ],
)
def test_mistakes_are_named(bag: Path, call: Any, words: str) -> None:
    with pytest.raises(BagError, match=words):
        call(bag)


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"hello")
    with pytest.raises(BagDamaged, match="not an MCAP file"):
        list(read(tmp_path / "a.mcap"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(BagError, match=r"no \.mcap file"):
        list(read(tmp_path / "empty"))


def test_a_missing_part_is_named(tmp_path: Path, kit: Any) -> None:
    bag, _ = kit.record(tmp_path / "run", kit.run_frames(100), max_duration_ns=20_000_000)
    (bag / "run_2.mcap").unlink()
    with pytest.raises(BagError, match=r"run_2\.mcap is missing"):
        list(read(bag))


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_the_mcap_package_are_read(tmp_path: Path, compression: CompressionType) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=compression, chunk_size=200)
    writer.start("x", "y")
    schema = writer.register_schema("Thing", "jsonschema", b'{"type": "object"}')
    text = writer.register_channel("/json", "json", schema)
    raw = writer.register_channel("/raw", "cdr", writer.register_schema("R", "ros2msg", b"int64 x"))
    for i in range(30):
        writer.add_message(text, i, b'{"x": [1, 2.5]}', i, i)
        writer.add_message(raw, i, b"\x01\x02", i, i)
    writer.finish()  # type: ignore[no-untyped-call]
    path = tmp_path / "other.mcap"
    path.write_bytes(buffer.getvalue())
    values = {m.topic: m.value for m in read(path)}
    assert values == {"/json": {"x": [1, 2.5]}, "/raw": b"\x01\x02"}
    assert sum(1 for _ in read(path)) == 60


def test_a_file_without_chunks_is_refused_not_read_as_empty(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer, use_chunking=False)
    writer.start("x", "y")
    channel = writer.register_channel("/a", "json", 0)
    writer.add_message(channel, 0, b"{}", 0, 0)
    writer.finish()  # type: ignore[no-untyped-call]
    path = tmp_path / "flat.mcap"
    path.write_bytes(buffer.getvalue())
    with pytest.raises(BagError, match="without chunks"):
        list(read(path))
    path.write_bytes(buffer.getvalue()[:-10])
    with pytest.raises(BagError, match="outside any chunk"):
        list(read(path))


def test_memory_stays_flat(tmp_path: Path, kit: Any) -> None:
    peaks = []
    for count in (2_000, 8_000):
        bag, _ = kit.record(tmp_path / str(count), kit.run_frames(count), chunk_bytes=16_384)
        tracemalloc.start()
        assert sum(1 for _ in read(bag)) == count + 2
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]
