from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from palp_core import Message
from palp_core.graph.bag.recorder import BagRecorder, RecordingSummary
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import Topic
from palp_core.units import Metres, Nanoseconds, NewtonMetresArray


class Place(Message):
    """Where."""

    depth_m: Metres


class Block(Message):
    """Everything that a message can hold."""

    stamp_ns: Nanoseconds
    torque_n_m: NewtonMetresArray
    over_phantom: bool = True
    text: str = ""
    raw: bytes = b""
    counts: list[int] = []
    place: Place = Place(depth_m=0.0)
    places: list[Place] = []


class Mode(Message):
    """A latched value."""

    stamp_ns: Nanoseconds
    level: float


def describe(cls: type[Message], name: str, latched_depth: int = 0) -> Topic:
    schema = schema_of(cls)
    return Topic(
        name=name,
        type=schema.name,
        type_hash=f"{schema.type_hash:016x}",
        json_schema=schema.json_schema,
        latched_depth=latched_depth,
    )


def frame(
    topic: str, message: Message, sequence: int, stamp_ns: int, *, epoch: int = 0, kind: int = Kind.DATA
) -> bytes:
    payload = encode(message) if kind == Kind.DATA else b""
    type_hash = schema_of(type(message)).type_hash
    return pack(topic.encode(), kind, epoch, sequence, stamp_ns, type_hash, payload)


TOPICS = (describe(Block, "/torque/block"), describe(Mode, "/policy/mode", latched_depth=1))


def run_frames(count: int, seed: int = 0) -> list[tuple[int, bytes]]:
    """A run: a mode, then blocks at 1000 Hz with random samples, a mode again at the middle."""
    rng = np.random.default_rng(seed)
    frames = [(0, frame("/policy/mode", Mode(stamp_ns=0, level=0.5), 1, 0))]
    for i in range(count):
        now_ns = i * 1_000_000
        block = Block(stamp_ns=now_ns, torque_n_m=rng.normal(size=4), counts=[i, i + 1])
        frames.append((now_ns, frame("/torque/block", block, i + 1, now_ns)))
        if i == count // 2:
            frames.append((now_ns, frame("/policy/mode", Mode(stamp_ns=now_ns, level=1.5), 2, now_ns)))
    return frames


def record(
    folder: Path, frames: Iterable[tuple[int, bytes]], **options: Any
) -> tuple[Path, RecordingSummary]:
    recorder = BagRecorder(BagWriter(folder, **options), TOPICS, attachments={"launch.yaml": b"graph: rig\n"})
    for now_ns, raw in frames:
        recorder(now_ns, raw)
    return folder, recorder.close()


def foreign_bag(
    path: Path,
    messages: Iterable[tuple[str, int, int, int]],
    encoding: str = "json",
    notes: dict[str, str] | None = None,
    schema: bytes = b'{"type": "object", "properties": {}}',
    **layout: Any,
) -> Path:
    """Write a file of another program.

    Args:
        path: The file.
        messages: Topic, publisher, sequence and log time in ns of each, which is empty.
        encoding: Theirs.
        notes: Metadata of the file and of every channel.
        schema: Theirs, as JSON.
        layout: Options of the package mcap.
    """
    payload = {"json": b"{}", "msgpack": b"\x80"}.get(encoding, b"\0\1\0\0")
    with path.open("wb") as file:
        writer = Writer(file, **layout)
        writer.start("", "other")
        writer.add_metadata("other", notes or {})
        described = writer.register_schema("S", "jsonschema", schema)
        channels: dict[tuple[str, int], int] = {}
        for topic, publisher, sequence, log_ns in messages:
            if (topic, publisher) not in channels:
                channels[topic, publisher] = writer.register_channel(topic, encoding, described, notes or {})
            writer.add_message(channels[topic, publisher], log_ns, payload, log_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """200 blocks and 2 modes in chunks of about 20 messages."""
    return record(tmp_path / "run", run_frames(200), chunk_bytes=4096)[0]


@pytest.fixture
def kit() -> Any:
    """What a test needs to make frames and bags."""

    class Kit:
        Block, Mode, Place, TOPICS = Block, Mode, Place, TOPICS
        frame: Callable[..., bytes] = staticmethod(frame)
        describe: Callable[..., Topic] = staticmethod(describe)
        run_frames: Callable[..., list[tuple[int, bytes]]] = staticmethod(run_frames)
        record: Callable[..., tuple[Path, RecordingSummary]] = staticmethod(record)

    return Kit
