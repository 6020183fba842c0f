import csv
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from palp_core.errors import BagError
from palp_core.extras import install_line
from palp_core.graph.bag.forms import convert
from palp_core.graph.bag.reader import read, to_numpy
from palp_core.graph.bag.ros2.export_bag import message_texts


@pytest.fixture
def rich(tmp_path: Path, kit: Any) -> Path:
    """Three messages with something in every field."""
    frames = []
    for i in range(3):
        block = kit.Block(
            stamp_ns=i,
            torque_n_m=np.arange(float(i)),
            over_phantom=i == 1,
            text="é",
            raw=bytes([i, 255]),
            counts=[-i, 2**40],
            place=kit.Place(depth_m=0.5),
            places=[kit.Place(depth_m=0.25)] * i,
        )
        frames.append((i * 10, kit.frame("/torque/block", block, i + 1, i)))
    bag: Path = kit.record(tmp_path / "rich", frames)[0]
    return bag


def test_rosbags_reads_the_ros_2_bag(rich: Path, tmp_path: Path) -> None:
    assert convert(rich, tmp_path / "ros", "ros2") == 3
    store = get_typestore(Stores.EMPTY)
    with Reader(tmp_path / "ros") as reader:
        (connection,) = reader.connections
        assert connection.topic == "/torque/block"
        assert connection.msgtype == "palp_msgs/msg/Block"
        store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        found = [
            (time_ns, store.deserialize_cdr(data, connection.msgtype))
            for _, time_ns, data in reader.messages()
        ]
    assert [time_ns for time_ns, _ in found] == [0, 10, 20]
    for original, (_, message) in zip(read(rich), found, strict=True):
        value: Any = original.value
        ros: Any = message
        assert ros.torque_n_m.tolist() == value.torque_n_m.tolist()
        assert (ros.stamp_ns, ros.over_phantom, ros.text) == (value.stamp_ns, value.over_phantom, value.text)
        assert ros.raw.tobytes() == value.raw
        assert ros.counts.tolist() == value.counts
        assert ros.place.depth_m == 0.5
        assert [p.depth_m for p in ros.places] == [p.depth_m for p in value.places]


@pytest.mark.parametrize(
    ("schema", "words"),
    [
        ({"title": "A", "properties": {"Bad__Name": {"type": "integer"}}}, "lower case"),
        ({"title": "A", "properties": {"x": {}}}, "cannot have this"),
        ({"properties": {}}, "without a title"),
        (
            {
                "title": "A",
                "properties": {
                    "x": {"type": "object", "title": "B", "properties": {"y": {"type": "integer"}}},
                    "z": {"type": "object", "title": "B", "properties": {"y": {"type": "number"}}},
                },
            },
            "two different messages are called B",
        ),
    ],
)
def test_what_ros_cannot_say_is_named(schema: dict[str, Any], words: str) -> None:
    with pytest.raises(BagError, match=words):
        message_texts(schema)


def test_json_messages_have_lists_and_a_root_that_is_an_object(rich: Path, tmp_path: Path) -> None:
    assert convert(rich, tmp_path / "json", "json") == 3
    with (tmp_path / "json/json_0.mcap").open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    schema, channel, message = found[2]
    assert schema is not None
    assert channel.message_encoding == "json"
    assert schema.encoding == "jsonschema"
    described = json.loads(schema.data)
    assert described["type"] == "object"
    assert "x-dtype" not in json.dumps(described)  # of what is nested neither
    assert described["properties"]["torque_n_m"] == {
        "type": "array",
        "items": {"type": "number"},
        "x-unit": "N m",
    }
    value = json.loads(message.data)
    assert value["torque_n_m"] == [0.0, 1.0]
    assert value["places"] == [{"depth_m": 0.25}] * 2
    assert [m.value["counts"] for m in read(tmp_path / "json")] == [[0, 2**40], [-1, 2**40], [-2, 2**40]]


def test_tables_read_back_as_they_were(bag: Path, rich: Path, tmp_path: Path, kit: Any) -> None:
    assert convert(bag, tmp_path / "csv", "csv") == 202
    with (tmp_path / "csv/torque.block.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    torque_n_m = to_numpy(bag, "/torque/block", "torque_n_m")
    assert np.array([[float(v) for v in row["torque_n_m"].split()] for row in table]).tolist() == (
        torque_n_m.tolist()
    )
    assert table[7]["sequence"] == "8"
    assert table[7]["place.depth_m"] == "0.0"
    assert convert(rich, tmp_path / "rich-csv", "csv") == 3
    with pytest.raises(BagError, match="exists already"):
        convert(bag, tmp_path / "csv", "csv")


def test_parquet_reads_back_and_says_what_it_needs(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if pq := pytest.importorskip("pyarrow.parquet"):
        assert convert(bag, tmp_path / "there", "parquet") == 202
        assert pq.read_table(tmp_path / "there/torque.block.parquet").num_rows == 200
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(BagError, match=re.escape(install_line("parquet"))):
        convert(bag, tmp_path / "parquet", "parquet")
