"""What a bag knows about a topic, and how an MCAP channel has it.

A channel holds the messages of one topic, one epoch of its publisher and one message type: a restart begins
a new channel, so that its sequence from 1 reads neither as repeats nor as a gap. A sequence has 64 bits on
the wire and 32 in MCAP; the channel carries the upper half.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import msgspec

from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.mcap.records import Channel, Schema
from palp_core.graph.messages.qos import POLICIES
from palp_core.graph.messages.schema_types import payload_decoder
from palp_core.graph.messages.topic import ANY_SCHEMA, Topic

MESSAGE_ENCODING = "msgpack"
SCHEMA_ENCODING = "jsonschema"


class Stream(msgspec.Struct, frozen=True, kw_only=True):
    """One channel: messages of a topic within an epoch; another tool's count by themselves."""

    topic: Topic
    epoch: int = 0  # how often its publisher was restarted before
    sequence_high: int = 0  # upper 32 bits of every sequence
    repeated: bool = False  # latched messages that an earlier file of the bag has
    encoding: str = MESSAGE_ENCODING
    schema_encoding: str = SCHEMA_ENCODING
    foreign_schema: bytes = b""  # of another encoding, or no JSON object
    publisher: int = 0  # the channel in another tool's file

    @property
    def key(self) -> tuple[Any, ...]:
        return (
            self.topic.name,
            self.topic.type,
            self.topic.type_hash,
            self.epoch,
            self.sequence_high,
            self.repeated,
            self.encoding,
            self.publisher,
        )

    def schema(self, id_: int) -> Schema:
        data = self.foreign_schema
        if self.schema_encoding == SCHEMA_ENCODING and not data:
            data = json.dumps(self.topic.json_schema, separators=(",", ":")).encode()
        return Schema(id=id_, name=self.topic.type, encoding=self.schema_encoding, data=data)

    def channel(self, id_: int, schema_id: int) -> Channel:
        metadata = {"epoch": str(self.epoch)}
        if self.topic.type_hash:
            metadata["type_hash"] = self.topic.type_hash
        if self.topic.latched_depth:
            metadata["latched_depth"] = str(self.topic.latched_depth)
        if self.sequence_high:
            metadata["sequence_high"] = str(self.sequence_high)
        if self.repeated:
            metadata["repeated"] = "true"
        if self.publisher:
            metadata["publisher"] = str(self.publisher)
        return Channel(
            id=id_,
            schema_id=schema_id,
            topic=self.topic.name,
            message_encoding=self.encoding,
            metadata=metadata,
        )

    @classmethod
    def of(cls, channel: Channel, schema: Schema | None) -> Stream:
        """Return the stream of a channel's records; what is not of palp's form is another tool's."""
        metadata = channel.metadata
        numbers = {key: int(text) for key, text in metadata.items() if text.isdecimal() and len(text) < 11}
        json_schema, foreign = ANY_SCHEMA, b"" if schema is None else schema.data
        if schema is not None and schema.encoding == SCHEMA_ENCODING:
            with suppress(ValueError, RecursionError):
                if isinstance(found := json.loads(foreign or b"{}"), dict):
                    json_schema, foreign = found or ANY_SCHEMA, b""
        topic = Topic(
            name=channel.topic,
            type="" if schema is None else schema.name,
            type_hash=metadata.get("type_hash", ""),
            json_schema=json_schema,
            latched_depth=min(numbers.get("latched_depth", 0), POLICIES["depth"].most),
        )
        return cls(
            topic=topic,
            epoch=numbers.get("epoch", 0),
            sequence_high=numbers.get("sequence_high", 0),
            repeated=metadata.get("repeated") == "true",
            encoding=channel.message_encoding,
            schema_encoding=SCHEMA_ENCODING if schema is None else schema.encoding,
            foreign_schema=foreign,
            publisher=numbers.get("publisher", 0 if "epoch" in numbers else channel.id),
        )


def decoder_for(stream: Stream) -> Callable[[bytes], Any]:
    """Return the function that decodes a stream's payloads.

    Structs where the bag has a schema, dicts where it has none.

    Raises:
        BagError: The encoding is neither msgpack nor JSON.
    """
    if stream.encoding == "json":
        return msgspec.json.decode
    if stream.encoding != MESSAGE_ENCODING:
        raise BagError(
            f"{stream.topic.name}: palp does not decode '{stream.encoding}', only msgpack and JSON; "
            "leave the topic out, or make a palp bag of a rosbag2: palp bag convert BAG --from ros2 -o NEW"
        )
    try:
        return payload_decoder(stream.topic.json_schema, stream.topic.type or "Value")
    except SchemaMismatch as error:
        raise BagError(str(error)) from error
