import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.edit import rewrite
from palp_core.graph.bag.mcap.chunk import compressor, decompress, open_chunk, split_chunk
from palp_core.graph.bag.mcap.records import (
    Attachment,
    Metadata,
    pack,
    pack_metadata,
    parse_attachment,
    parse_metadata,
)
from palp_core.graph.bag.reader import Bag, read
from palp_core.graph.bag.recover import recover
from palp_core.graph.messages.schema_types import plain, type_from_schema


def test_a_chunk_that_lies_about_its_size_is_refused() -> None:
    data = bytes(1000)
    for name in ("zstd", "lz4", "none"):
        stored_name, compress = compressor(name)
        stored = bytes(compress(data))
        assert decompress(stored_name, stored, 1000) == data
        for size in (999, 1001, 1 << 40):
            with pytest.raises(ValueError, match=r"bytes|size|decompress"):
                decompress(stored_name, stored, size)
    with pytest.raises(ValueError, match="unknown compression"):
        decompress("rar", b"", 0)
    with pytest.raises(BagError, match="use one of zstd, lz4, none"):
        compressor("rar")  # type: ignore[arg-type]


def test_records_that_make_no_sense_or_changed_are_refused() -> None:
    ignore: Any = lambda op, content: None  # noqa: E731
    for records, words in (
        (b"\x05" + bytes(4), "unpack"),
        (b"\x05" + (3).to_bytes(8, "little") + bytes(40), "shorter than its head"),
        (b"\x05" + (90).to_bytes(8, "little") + bytes(40), "not whole"),
        (b"\x03" + (90).to_bytes(8, "little") + bytes(40), "not whole"),
        (bytes(9), "record 0"),
    ):
        with pytest.raises(ValueError, match=words):
            split_chunk(records, ignore)
    assert split_chunk(b"\x05" + bytes(4), ignore, torn=True) == []
    with pytest.raises(ValueError, match="is not a chunk"):
        open_chunk(b"\x05" + bytes(60))
    packed = bytearray(pack(Attachment(0, 0, "a", "", b"hello"))[9:])
    packed[-6] ^= 1
    with pytest.raises(ValueError, match="CRC"):
        parse_attachment(bytes(packed))
    with pytest.raises(ValueError, match="CRC"):
        parse_metadata(pack_metadata(Metadata("a", {"k": "v"}))[9:].replace(b"v", b"w"))


def test_foreign_schemas_survive_a_copy(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start("ros2", "other")
    schema = writer.register_schema("std_msgs/msg/Int64", "ros2msg", b"int64 data")
    channel = writer.register_channel("/n", "cdr", schema, {"offered_qos_profiles": ""})
    writer.add_message(channel, 5, b"\0\1\0\0" + bytes(8), 5, 1)
    writer.finish()  # type: ignore[no-untyped-call]
    path = tmp_path / "ros.mcap"
    path.write_bytes(buffer.getvalue())
    assert rewrite([path], tmp_path / "copy") == 1
    with Bag(tmp_path / "copy") as bag:
        (message,) = bag.recorded()
    stream = message.stream
    assert (stream.foreign_schema, stream.schema_encoding) == (b"int64 data", "ros2msg")
    assert stream.topic.type == "std_msgs/msg/Int64"


def test_schemas_become_types() -> None:
    assert type_from_schema({}) is Any
    assert type_from_schema({"type": "object"}) == dict[str, Any]
    odd: dict[str, Any] = {"type": "object", "properties": {"class": {"type": "integer"}}}
    assert type_from_schema(odd) == dict[str, Any]
    odd["properties"]["maybe"] = {"type": ["number", "null"]}
    assert type_from_schema(odd) == dict[str, Any]
    with pytest.raises(SchemaMismatch, match="'null'"):
        type_from_schema({"type": "null"})
    with pytest.raises(SchemaMismatch, match="not valid in a message"):
        type_from_schema({"type": ["number", "null"]})
    assert plain({"a": (np.arange(2.0), b"\1")}) == {"a": [[0.0, 1.0], "AQ=="]}


def test_a_payload_that_is_not_its_type_is_named(tmp_path: Path, kit: Any) -> None:
    raw = kit.frame("/policy/mode", kit.Mode(stamp_ns=0, level=0.5), 1, 0)
    bag, _ = kit.record(tmp_path / "run", [(0, raw.replace(b"level", b"lever"))])
    with pytest.raises(BagError, match="/policy/mode epoch 0 sequence 1: not of its schema"):
        list(read(bag))


def test_messages_whose_definition_is_gone_are_counted(tmp_path: Path, kit: Any) -> None:
    bag, _ = kit.record(tmp_path / "run", kit.run_frames(200), chunk_bytes=4096)
    with Bag(bag) as opened:
        chunks = opened.files[0].chunks
    data = bytearray((bag / "run_0.mcap").read_bytes())[: chunks[-1].offset + chunks[-1].length]
    for place in chunks[:2]:
        data[place.offset + place.length - 1] ^= 1
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    report = recover(path, tmp_path / "saved")
    assert report.orphan_count > 100
    assert "messages of unknown topics" in report.text()
    assert report.damaged_chunk_count == 2
