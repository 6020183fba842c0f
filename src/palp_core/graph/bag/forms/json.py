"""A bag of JSON messages, as Foxglove and Lichtblick open it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from palp_core.graph.bag.mcap.compression import Compression
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.stream import Stream, decoder_for
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.schema_reader import fields_of, is_array
from palp_core.graph.messages.schema_types import plain


def write(bag: str | Path, out: str | Path, compression: Compression = "zstd") -> int:
    """Write a bag of JSON messages; arrays become lists of numbers.

    JSON has no NaN and no infinity: they become null.
    """
    ways: dict[int, tuple[Stream, int, Callable[[bytes], Any]]] = {}
    count = 0
    with Bag(bag) as opened, BagWriter(out, compression=compression) as writer:
        for name, data in opened.attachments().items():
            writer.attach(name, data)
        for stream, sequence, log_ns, publish_ns, payload in opened.recorded():
            way = ways.get(id(stream))
            if way is None:
                topic = msgspec.structs.replace(stream.topic, json_schema=json_form(stream.topic.json_schema))
                converted = msgspec.structs.replace(stream, topic=topic, encoding="json")
                way = ways[id(stream)] = (stream, writer.stream(converted), decoder_for(stream))
            text = msgspec.json.encode(plain(way[2](payload)))
            writer.write(way[1], sequence, log_ns, publish_ns, text)
            count += 1
    return count


def json_form(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema in which binary arrays are lists of numbers."""
    if is_array(schema):
        kept = {key: value for key, value in schema.items() if key.startswith("x-") and key != "x-dtype"}
        return {"type": "array", "items": {"type": "number"}, **kept}
    changed = dict(schema)
    if fields := fields_of(schema):
        changed["properties"] = {name: json_form(inner) for name, inner in fields.items()}
    if "items" in schema:
        changed["items"] = json_form(schema["items"])
    return changed
