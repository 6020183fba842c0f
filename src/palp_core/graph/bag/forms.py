"""A bag as what other tools open: JSON messages, flat tables, one per topic (CSV and Parquet), a rosbag2."""

import contextlib
import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec

from palp_core.errors import BagError
from palp_core.extras import install_line
from palp_core.foreign import catch_foreign
from palp_core.graph.bag.edit import copy_messages
from palp_core.graph.bag.reader import Bag, BagMessage, RecordedMessage
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter, whole_folder
from palp_core.graph.messages.schema_reader import fields_of, is_array, items_of
from palp_core.graph.messages.schema_types import plain

HEAD = ("log_ns", "publish_ns", "epoch", "sequence")
PARQUET_ROWS = 8192
Form = Literal["ros2", "json", "csv", "parquet"]


def convert(bag: str | Path, out: str | Path, form: Form) -> int:
    """Write a bag in another form; return how many messages there are."""
    from palp_core.graph.bag.ros2 import export_bag

    writers: dict[Form, Callable[[str | Path, str | Path], int]] = {
        "ros2": export_bag.write, "json": write_json, "csv": write_csv, "parquet": write_parquet,
    }  # fmt: skip
    with writing(out) as folder:
        return writers[form](bag, folder)


@contextlib.contextmanager
def writing(out: str | Path) -> Iterator[Path]:
    """Give the path at which to write another form; what goes wrong becomes a BagError and leaves nothing."""
    with catch_foreign(f"{out} cannot be written", BagError), whole_folder(out) as folder:
        yield folder


def write_json(bag: str | Path, out: str | Path) -> int:
    """Write a bag of JSON messages; arrays become lists of numbers.

    JSON has no NaN and no infinity: they become null.
    """
    streams: dict[int, Stream] = {}  # by identity: streams live as long as the bag

    def as_json(message: RecordedMessage, decoded: BagMessage) -> RecordedMessage:
        stream = message.stream
        if id(stream) not in streams:
            topic = msgspec.structs.replace(stream.topic, json_schema=json_form(stream.topic.json_schema))
            streams[id(stream)] = msgspec.structs.replace(stream, topic=topic, encoding="json")
        return message._replace(stream=streams[id(stream)], payload=msgspec.json.encode(plain(decoded.value)))

    with Bag(bag).whole() as opened, BagWriter(out) as writer:
        for name, data in opened.attachments().items():
            writer.attach(name, data)
        return copy_messages(map(as_json, opened.recorded(), opened.messages()), writer)


def json_form(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema in which binary arrays are lists of numbers."""
    if is_array(schema):
        kept = {key: value for key, value in schema.items() if key.startswith("x-") and key != "x-dtype"}
        return {"type": "array", "items": {"type": "number"}, **kept}
    changed = dict(schema)
    if fields := fields_of(schema):
        changed["properties"] = {name: json_form(inner) for name, inner in fields.items()}
    if "items" in schema:
        changed["items"] = json_form(items_of(schema))
    return changed


def write_csv(bag: str | Path, out: str | Path) -> int:
    """Write one CSV file per topic into a folder; a list is one cell, its elements separated by spaces.

    Numbers are written so that they read back as they were.
    """
    (folder := Path(out)).mkdir()
    tables: dict[str, Any] = {}
    count = 0
    with Bag(bag).whole() as opened, contextlib.ExitStack() as stack:
        for topic, row in _rows(opened):
            table = tables.get(topic)
            if table is None:
                path = folder / f"{_table_name(topic)}.csv"
                file = stack.enter_context(path.open("x", newline="", encoding="utf-8"))
                table = tables[topic] = csv.DictWriter(file, list(row), restval="")
                table.writeheader()
            try:
                table.writerow({name: _cell(value) for name, value in row.items()})
            except ValueError as error:
                raise BagError(
                    f"{topic}: without a schema, a later message has other fields: {error}"
                ) from error
            count += 1
    return count


def _cell(value: Any) -> Any:
    if isinstance(value, list):
        simple = all(isinstance(item, int | float) for item in value)
        return " ".join(map(repr, value)) if simple else msgspec.json.encode(value).decode()
    return value


def write_parquet(bag: str | Path, out: str | Path) -> int:
    """Write one Parquet file per topic into a folder; needs ``pyarrow``."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise BagError(f"Parquet needs pyarrow; type: {install_line('parquet')}") from error
    (folder := Path(out)).mkdir()
    tables: dict[str, Any] = {}
    waiting: dict[str, list[dict[str, Any]]] = {}

    def flush(topic: str) -> None:
        table = pa.Table.from_pylist(waiting.pop(topic), tables[topic].schema if topic in tables else None)
        if topic not in tables:
            path = folder / f"{_table_name(topic)}.parquet"
            tables[topic] = stack.enter_context(pq.ParquetWriter(path, table.schema))
        tables[topic].write_table(table)

    count = 0
    with Bag(bag).whole() as opened, contextlib.ExitStack() as stack:
        for topic, row in _rows(opened):
            waiting.setdefault(topic, []).append(row)
            count += 1
            if len(waiting[topic]) >= PARQUET_ROWS:
                flush(topic)
        for topic in list(waiting):
            flush(topic)
    return count


def _table_name(topic: str) -> str:
    """Return the file name of a topic's table, without ending."""
    return topic.strip("/").replace("/", ".") or "root"


def _rows(bag: Bag) -> Iterator[tuple[str, dict[str, Any]]]:
    """Iterate messages as flat rows with their topic; a nested field is ``outer.inner``."""
    for message in bag.messages():
        row: dict[str, Any] = {name: getattr(message, name) for name in HEAD}
        for name, value in _flat(plain(message.value), ""):
            row[name if name not in row else f"message.{name}"] = value
        yield message.topic, row


def _flat(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat(inner, f"{path}.{name}" if path else name)
    else:
        yield path or "value", value
