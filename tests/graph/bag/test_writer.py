import io
from pathlib import Path
from typing import Any

import msgpack
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader

from palp_core.errors import BagError
from palp_core.graph.bag.mcap.file_writer import FileWriter
from palp_core.graph.bag.mcap.records import Channel, Schema
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.topic import Topic

LAWS = settings(max_examples=25)
U64 = st.integers(0, 2**63 - 1)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_the_mcap_package_reads_everything_with_its_crcs(tmp_path: Path, kit: Any, compression: str) -> None:
    frames = kit.run_frames(100)
    bag, _ = kit.record(tmp_path / "run", frames, chunk_bytes=2048, compression=compression)
    data = (bag / "run_0.mcap").read_bytes()
    assert sum(1 for _ in NonSeekingReader(io.BytesIO(data), validate_crcs=True).iter_messages()) == 102
    assert list(StreamReader(io.BytesIO(data), validate_crcs=True).records)
    with io.BytesIO(data) as file:
        reader = make_reader(file, validate_crcs=True)
        found = list(reader.iter_messages(log_time_order=False))
        summary = reader.get_summary()
        window = list(
            reader.iter_messages(["/torque/block"], starting_at=50_000_000, ending_before=60_000_000)
        )
        attachments = {a.name: a.data for a in reader.iter_attachments()}
    assert [m.sequence for _, _, m in window] == list(range(51, 61))
    assert [(c.topic, m.sequence) for _, c, m in found][:3] == [
        ("/policy/mode", 1),
        ("/torque/block", 1),
        ("/torque/block", 2),
    ]
    assert len(found) == len(frames)
    assert [m.data for _, _, m in found] == [raw[raw.index(0) + 33 :] for _, raw in frames]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(frames)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 3
    assert attachments["launch.yaml"] == b"graph: rig\n"
    schema, channel, message = found[1]
    assert schema is not None
    assert (channel.message_encoding, schema.encoding, schema.name) == ("msgpack", "jsonschema", "Block")
    assert msgpack.unpackb(message.data)["counts"] == [0, 1]


@LAWS
@given(
    messages=st.lists(
        st.tuples(st.sampled_from("abc"), st.integers(0, 2**64 - 1), U64, U64, st.binary(max_size=300)),
        max_size=60,
    ),
    compression=st.sampled_from(["zstd", "lz4", "none"]),
    chunk_bytes=st.integers(1, 2000),
    max_bytes=st.sampled_from([0, 1500]),
    max_files=st.sampled_from([0, 1, 2]),
)
def test_what_is_written_is_what_is_read_of_the_files_that_are_kept(
    tmp_path_factory: pytest.TempPathFactory,
    messages: list[tuple[str, int, int, int, bytes]],
    compression: Any,
    chunk_bytes: int,
    max_bytes: int,
    max_files: int,
) -> None:
    folder = tmp_path_factory.mktemp("law") / "run"
    with BagWriter(
        folder, compression=compression, chunk_bytes=chunk_bytes, max_bytes=max_bytes, max_files=max_files
    ) as writer:
        for name, sequence, log_ns, publish_ns, payload in messages:
            stream = writer.stream(Stream(topic=Topic(name=name), sequence_high=sequence >> 32))
            writer.write(stream, sequence, log_ns, publish_ns, payload)
    deleted_count = sum(writer.deleted.values())
    with Bag(folder) as bag:
        assert [
            (m.stream.topic.name, m.sequence, m.log_ns, m.publish_ns, m.payload) for m in bag.recorded()
        ] == messages[deleted_count:]
        assert not bag.problems
        assert len(bag.files) <= (max_files or len(bag.files))
    assert max_files or not deleted_count


def test_the_first_tick_closes_the_first_chunk_and_others_within_half_a_second(tmp_path: Path) -> None:
    writer = FileWriter(tmp_path / "x.mcap")
    writer.add_schema(Schema(1, b"{}", "jsonschema", ""))
    writer.add_channel(Channel(1, "/t", "msgpack", {}, 1))
    writer.tick(0)
    writer.write(1, 1, 0, 0, b"x")
    sizes = []
    writer.tick(1)
    with Bag(tmp_path / "x.mcap") as cut_off:
        assert len(list(cut_off.recorded())) == 1
    writer.write(1, 2, 0, 0, b"x")
    for now_ns in (100_000_000, 400_000_000, 500_000_000, 500_000_001):
        writer.tick(now_ns)
        sizes.append(writer.written_bytes)
    assert sizes[0] == sizes[2] < sizes[3]
    assert (tmp_path / "x.mcap").stat().st_size == sizes[3]
    writer.close()


@LAWS
@given(
    steps=st.lists(st.tuples(st.integers(1, 100_000_000), st.integers(0, 3)), max_size=60),
    silent=st.booleans(),
)
def test_a_crash_costs_at_most_0_6_s_of_wall_time(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[int, int]], silent: bool
) -> None:
    path = tmp_path_factory.mktemp("crash") / "x.mcap"
    writer = FileWriter(path)
    writer.add_schema(Schema(1, b"{}", "jsonschema", ""))
    writer.add_channel(Channel(1, "/t", "msgpack", {}, 1))
    wall_ns, sequence, written = 0, 0, []
    if not silent:
        writer.tick(0)
    for pause_ns, count in steps:
        for _ in range(count):
            sequence += 1
            writer.write(1, sequence, 0, 0, b"")
            written.append(wall_ns)
        wall_ns += pause_ns
        writer.tick(wall_ns)
        if written:
            with Bag(path) as bag:
                saved = sum(1 for _ in bag.recorded())
            assert all(wall_ns - at_ns < 600_000_000 for at_ns in written[saved:])
    writer.close()


def test_each_file_of_a_split_begins_with_the_latched_values_and_the_bag_shows_them_once(
    tmp_path: Path, kit: Any
) -> None:
    bag, _ = kit.record(tmp_path / "run", kit.run_frames(100), max_duration_ns=20_000_000)
    files = sorted(bag.glob("*.mcap"))
    assert len(files) == 5
    with Bag(files[2]) as alone:
        first = next(iter(alone.messages()))
        assert (first.topic, first.sequence, first.value.level) == ("/policy/mode", 1, 0.5)
        assert first.publish_ns == 0
        assert alone.attachments()["launch.yaml"]
    with Bag(files[4]) as last:
        assert next(iter(last.messages())).value.level == 1.5
    with Bag(bag) as whole:
        modes = [m.sequence for m in whole.recorded(["/policy/mode"])]
        blocks = [m.sequence for m in whole.recorded(["/torque/block"])]
    assert modes == [1, 2]
    assert blocks == list(range(1, 101))


def test_metadata_has_the_form_of_rosbag2(bag: Path) -> None:
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["message_count"] == 202
    assert information["duration"] == {"nanoseconds": 199_000_000}
    assert information["relative_file_paths"] == ["run_0.mcap"]
    topics = {
        t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]
    }
    assert topics == {"/policy/mode": 2, "/torque/block": 200}


def test_unknown_channels_and_impossible_times_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_metadata("git", {"commit": "abc"})
        with pytest.raises(BagError, match="no channel 7"):
            writer.write(7, 1, 0, 0, b"")
        stream = writer.stream(Stream(topic=Topic(name="/t")))
        with pytest.raises(BagError, match="stamped -1"):
            writer.write(stream, 1, 0, -1, b"")
        writer.write(stream, 1, 0, 0, b"\x80")
    with Bag(tmp_path / "run") as bag:
        assert sum(1 for _ in bag.recorded()) == 1
        assert bag.metadata() == {"git": {"commit": "abc"}}
