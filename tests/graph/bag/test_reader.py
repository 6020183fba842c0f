import json
import tracemalloc
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer

from palp_core.errors import BagError
from palp_core.graph.bag.edit import rewrite
from palp_core.graph.bag.forms import convert
from palp_core.graph.bag.info import bag_info
from palp_core.graph.bag.mcap.chunk import RawMessage
from palp_core.graph.bag.mcap.file_reader import ChunkPlace, FileReader
from palp_core.graph.bag.mcap.records import MAGIC, MESSAGE_BYTES
from palp_core.graph.bag.reader import Bag, read, to_numpy
from palp_core.graph.bag.recover import recover
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from tests.support.bags import foreign_bag


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
        (lambda bag: list(read(Path(__file__))), "not a bag; give"),
        (lambda bag: list(read(bag.parents[0])), r"no \.mcap file"),
    ],
)
def test_mistakes_are_named(bag: Path, call: Any, words: str) -> None:
    with pytest.raises(BagError, match=words):
        call(bag)


def test_a_missing_part_is_named(tmp_path: Path, kit: Any) -> None:
    bag, _ = kit.record(tmp_path / "run", kit.run_frames(100), max_duration_ns=20_000_000)
    (bag / "run_2.mcap").unlink()
    with pytest.raises(BagError, match=r"run_2\.mcap is missing"):
        list(read(bag))


LAYOUTS: dict[str, dict[str, Any]] = {
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "none": {"compression": CompressionType.NONE},
    "no CRCs": {"enable_crcs": False},
    "no index": {"index_types": IndexType.NONE},
    "no definitions": {"repeat_channels": False, "repeat_schemas": False},
    "no statistics": {"use_statistics": False, "repeat_channels": False},
    "no chunks": {"use_chunking": False},
    "no chunks, no CRCs": {"use_chunking": False, "enable_crcs": False},
    "no chunks, no definitions": {"use_chunking": False, "repeat_channels": False, "repeat_schemas": False},
    "no chunks, no summary": {"use_chunking": False, "use_statistics": False, "repeat_channels": False},
    "nothing at the end": {
        "use_statistics": False,
        "use_summary_offsets": False,
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
    },
}
"""Options of the package mcap; ``no summary``: as of a writer that was killed after the last message."""


def foreign_file(path: Path, layout: str, sequences: Iterable[int] = range(1, 51)) -> Path:
    """A file of another program: JSON on two topics, an attachment after the first message."""
    with path.open("wb") as file:
        writer = Writer(file, **{"chunk_size": 200, **LAYOUTS[layout]})
        writer.start("", "other")
        schema = writer.register_schema("S", "jsonschema", b'{"type": "object"}')
        for place, sequence in enumerate(sequences):
            if place in (0, 10):
                channel = writer.register_channel(f"/t{place}", "json", schema)
            data = json.dumps({"i": place, "pad": "\x05" * 20}).encode()
            writer.add_message(channel, place * 10**7, data, place * 10**7, sequence)
            if not place:
                writer.add_attachment(0, 0, "a.txt", "text/plain", b"abc")
        writer.finish()  # type: ignore[no-untyped-call]
    if "no summary" in layout:
        data = path.read_bytes()
        path.write_bytes(data[: data.rindex(b"}") + 1])
    return path


@pytest.mark.parametrize("layout", LAYOUTS)
def test_whatever_the_layout_of_anothers_file_every_message_is_read_and_saved(
    layout: str, tmp_path: Path
) -> None:
    path = foreign_file(tmp_path / "other.mcap", layout)
    found = bag_info(path)
    assert {name: topic.count for name, topic in found.topics.items()} == {"/t0": 10, "/t10": 40}
    assert found.healthy == found.complete == ("no summary" not in layout)
    assert found.attachments == ["a.txt"]
    assert [m.value["i"] for m in read(path, ["/t10"], start_ns=3 * 10**8)] == list(range(30, 50))
    if found.healthy:
        with pytest.raises(BagError, match="no topic /t1; it has: /t0, /t10"):
            list(read(path, ["/t1"]))
    report = recover(path, tmp_path / "saved")
    assert report.message_count == {"/t0": 10, "/t10": 40}
    assert report.unverified_count == (50 if layout == "no CRCs" or "no chunks" in layout else 0)
    assert [m.value["i"] for m in read(tmp_path / "saved")] == list(range(50))


@pytest.mark.parametrize("layout", ["no chunks", "no chunks, no summary"])
@pytest.mark.parametrize(
    ("harm", "saved"),
    [
        (lambda data, at: data[: at + 30], 20),  # cut amid a message
        (lambda data, at: data[:at] + bytes(len(data) - at), 20),  # zeros, as after a power cut
        (lambda data, at: data[: at + 1] + b"\xff\xff" + data[at + 3 :], 49),  # a length too large
        (lambda data, at: data[: at + 1] + b"\x10" + data[at + 2 :], 49),  # a length too small
        (lambda data, at: data[: at + 20] + b"noise" + data[at + 20 :], 49),
        (
            lambda data, at: bytes(8) + data[8 : at + 20] + b"noise" + data[at + 20 :],
            49,
        ),  # and the first bytes
    ],
)
def test_messages_outside_chunks_are_saved_around_a_damage(
    layout: str, harm: Callable[[bytes, int], bytes], saved: int, tmp_path: Path
) -> None:
    path = foreign_file(tmp_path / "other.mcap", layout)
    data = path.read_bytes()
    path.write_bytes(harm(data, data.index(b'{"i": 20') - MESSAGE_BYTES))
    if path.read_bytes().startswith(MAGIC):
        info = bag_info(path)
        assert not info.healthy
        assert not info.complete
    report = recover(path, tmp_path / "saved")
    assert sum(report.message_count.values()) == report.unverified_count == saved
    assert [m.value["i"] for m in read(tmp_path / "saved")] == [i for i in range(50) if i != 20][:saved]


@pytest.mark.parametrize(
    ("sequences", "numbered", "repeated", "lost"),
    [
        ([0] * 20, (False, False), 0, 0),
        ([*range(10)] * 2, (True, True), 0, 0),
        ([*range(10), *[0] * 10], (True, False), 0, 0),
        ([*range(10), *range(5), *range(4, 8), 9], (True, True), 1, 1),
        ([*[0] * 10, *[0] * 9, 4], (False, True), 8, 3),
    ],
)
def test_a_sequence_of_0_throughout_is_none(
    sequences: list[int],
    numbered: tuple[bool, bool],
    repeated: int,
    lost: int,
    tmp_path: Path,
) -> None:
    found = bag_info(foreign_file(tmp_path / "other.mcap", "lz4", sequences))
    assert tuple(topic.numbered for topic in found.topics.values()) == numbered
    assert sum(topic.repeated for topic in found.topics.values()) == repeated
    assert sum(topic.lost for topic in found.topics.values()) == lost
    assert found.message_count == 20 - repeated


@pytest.mark.parametrize(
    ("log_ms", "publish_ms", "count", "back_s"),
    [
        ([0, 10, 20, 30], [0, 10, 20, 30], 0, 0.0),
        ([0, 10, 10, 30], [0, 9, 9, 30], 0, 0.0),
        ([0, 10_000, 20, 30, 5], [0, 10, 20, 30, 40], 2, 9.98),  # the recorder's clock
        ([0, 10, 20, 30], [5000, 5010, 3, 13], 1, 5.007),  # the publisher's
    ],
)
def test_a_clock_that_goes_back_is_reported(
    log_ms: list[int], publish_ms: list[int], count: int, back_s: float, tmp_path: Path
) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "other")
        channels = [writer.register_channel(name, "json", 0) for name in ("/a", "/b")]
        for sequence, (log, publish) in enumerate(zip(log_ms, publish_ms, strict=True)):
            writer.add_message(channels[0], log * 10**6, b"{}", publish * 10**6, sequence)
            writer.add_message(channels[1], 10**12 + sequence, b"{}", 0, sequence)  # of another time base
        writer.finish()  # type: ignore[no-untyped-call]
    topics = bag_info(path).topics
    assert topics["/a"].backward_count == count
    assert topics["/a"].backward_s == pytest.approx(back_s)
    assert topics["/b"].backward_count == 0


S = 10**9
LATE = 1 << 63  # beyond what a signed number holds


@pytest.mark.parametrize(
    ("messages", "count", "repeated", "lost", "back"),
    [
        ([("/a", p, i, i) for i in (1, 2, 3) for p in (1, 2)], 6, 0, 0, (0, 0)),
        ([("/a", 1, i, i) for i in (1, 3)] + [("/a", 2, i, i) for i in (5, 9, 9)], 4, 1, 4, (0, 0)),
        ([("/a", 1, i, i) for i in (1, 3)] + [("/a", 2, 0, i) for i in (4, 5, 6)], 5, 0, 1, (0, 0)),
        ([("/a", 1, 1, 0), ("/b", 1, 1, 5 * S), ("/a", 1, 2, 4 * S)], 3, 0, 0, (0, 0)),
        ([("/a", 1, 1, 0), ("/b", 1, 1, 5 * S), ("/a", 1, 2, 4 * S - 1)], 3, 0, 0, (1, S + 1)),
        (
            [("/a", 1, 1, 9 * S), ("/b", 1, 1, 0), ("/c", 1, 1, 9 * S), ("/d", 1, 1, 5 * S)],
            4,
            0,
            0,
            (2, 9 * S),
        ),
        ([("/a", 1, i, LATE + i * S) for i in (1, 2, 4)], 3, 0, 1, (0, 0)),
    ],
)
@pytest.mark.parametrize("layout", [{}, {"use_chunking": False, "enable_crcs": False}])
def test_what_another_program_recorded_is_accounted_for_and_kept_in_a_copy(
    messages: list[tuple[str, int, int, int]],
    count: int,
    repeated: int,
    lost: int,
    back: tuple[int, int],
    layout: dict[str, Any],
    tmp_path: Path,
) -> None:
    notes = {"offered_qos_profiles": "- depth: 1", "epoch": "-1", "latched_depth": "9" * 5000, "x": "é"}
    path = foreign_bag(tmp_path / "other.mcap", messages, notes=notes, **layout)
    rewrite([path], tmp_path / "copy")
    assert recover(path, tmp_path / "saved").complete == (lost == 0)
    for bag in (path, tmp_path / "copy", tmp_path / "saved"):
        found = bag_info(bag)
        assert (found.problems, len(found.files)) == ([], 1)
        assert found.message_count == count
        assert sum(topic.repeated for topic in found.topics.values()) == repeated
        assert sum(topic.lost for topic in found.topics.values()) == lost
        assert (found.backward_count, found.backward_s) == (back[0], back[1] / S)
        assert found.start_s == min(message[3] for message in messages) / 1e9
        with Bag(bag) as opened:
            assert opened.metadata() == {"other": notes}
            assert [m.log_ns for m in opened.recorded()] == [message[3] for message in messages]


@pytest.mark.parametrize(
    "schema",
    [b"[]", b"nope", b"{}"]
    + [b'{"type": "object", "properties": %s, "items": true}' % odd for odd in (b"[1]", b'{"x": true}')],
)
def test_a_schema_of_another_form_is_kept_and_decodes_to_what_is_there(schema: bytes, tmp_path: Path) -> None:
    path = foreign_bag(tmp_path / "other.mcap", [("/a", 1, 1, 0)], schema=schema)
    assert rewrite([path], tmp_path / "copy") == convert(path, tmp_path / "json", "json") == 1
    assert [message.value for message in read(tmp_path / "json")] == [{}]
    with Bag(path) as old, Bag(tmp_path / "copy") as new:
        (one,), (two,) = old.streams(), new.streams()
        assert (one.foreign_schema, one.topic) == (two.foreign_schema, two.topic)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_chunk_is_read_once_where_no_summary_tells_what_is_in_it(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, offsets, read_at = foreign_file(tmp_path / "other.mcap", layout), [], FileReader._read_at

    def spy(self: FileReader, offset: int, size: int) -> bytes:
        offsets.append((offset, size))
        return read_at(self, offset, size)

    monkeypatch.setattr(FileReader, "_read_at", spy)
    bag_info(path)
    with Bag(path) as opened:
        for place in opened.files[0].chunks:
            if not (place.bare or place.entry):
                assert offsets.count((place.offset, place.length)) == 1


def test_memory_stays_flat(tmp_path: Path, kit: Any) -> None:
    peaks = []
    for count in (2_000, 8_000):
        bag, _ = kit.record(tmp_path / str(count), kit.run_frames(count), chunk_bytes=16_384)
        tracemalloc.start()
        assert sum(1 for _ in read(bag)) == count + 2
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]
