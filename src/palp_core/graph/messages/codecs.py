"""Task ``codec``: how a message becomes bytes, and the two ways that it is not done by.

Declared for who asks the register: nothing that runs imports this. The choice itself costs a comparison per
large array, of the number at which the valid ranges meet: :data:`.fragments.CUT_FROM`.
"""

import json
from typing import Any

import msgpack
import msgspec
import numpy as np

from palp_core.graph.messages.fragments import CUT_FROM, cut
from palp_core.graph.messages.message import Message, encode
from palp_core.graph.messages.schema import schema_of
from palp_core.methods import Bound, declare_task, method

LARGEST_BYTES = 2**32 - 1
"""Of one ``bin`` of msgpack, whose length has 32 bits."""

SIZES = (400, 1 << 16, 1 << 20)
"""Bytes of the arrays at which costs are stated: a block of 50 samples, and one on either side of the cut."""

EVIDENCE = "tests/graph/transport/test_codec_methods.py"

declare_task(
    "codec",
    "How does a message become bytes?",
    per="a message of 50 samples (in pieces: of 1 MiB) from publisher to reader",
    output="value",
    tolerance=0.0,
)


def _cpu(*seconds: float) -> list[Bound]:
    """Return the CPU time of both ends up to each of the first sizes: seen, and a third."""
    return [
        Bound("cpu_s", most_s, within={"array_bytes": (0.0, size)})
        for size, most_s in zip(SIZES, seconds, strict=False)
    ]


@method(
    task="codec",
    name="msgpack",
    cost_s=2e-5,
    bounds=[Bound("value", 0.0), *_cpu(3.7e-5, 7.1e-5, 3.4e-3)],
    evidence=EVIDENCE,
    valid={"array_bytes": (0.0, LARGEST_BYTES)},
    fails="a message of the wrong type, unit or bound arrives as if nothing were wrong",
    survivor="one_frame",
    reference="shows what types, units and bounds cost",
)
def encode_plain(message: Message) -> bytes:
    """Return the same msgpack map as :func:`.message.encode`, made of a dict by the plain library."""
    packed: bytes = msgpack.packb(
        {
            name: value.tobytes() if isinstance(value, np.ndarray) else value
            for name, value in msgspec.structs.asdict(message).items()
        }
    )
    return packed


def decode_plain(cls: type[Message], data: bytes | memoryview) -> dict[str, Any]:
    """Return what the plain library reads, with arrays as arrays, and nothing checked."""
    values: dict[str, Any] = msgpack.unpackb(data)
    for field in schema_of(cls).fields:
        if field.packed:
            values[field.name] = np.frombuffer(values[field.name], dtype="<f8")
    return values


@method(
    task="codec",
    name="one_frame",
    cost_s=2.2e-5,
    bounds=[Bound("value", 0.0), *_cpu(4.1e-5, 7.1e-5)],
    evidence=EVIDENCE,
    valid={"array_bytes": (0.0, CUT_FROM - 1)},
    fails="beyond, copying the array at each end takes longer than handing its memory over between threads",
    survivor="pieces",
)
def encode_one_frame(message: Message) -> bytes:
    """Return typed msgpack behind the header, in one frame: :func:`.message.encode`."""
    return encode(message)


@method(
    task="codec",
    name="json",
    cost_s=5.2e-5,
    bounds=[Bound("value", 0.0), *_cpu(9.8e-5, 9.2e-3, 0.16)],
    evidence=EVIDENCE,
    valid={"array_bytes": (0.0, LARGEST_BYTES)},
    fails="NaN and infinity are no JSON; a number takes 24 bytes and 0.9 us",
    survivor="one_frame",
    reference="shows what text costs",
)
def encode_json(message: Message) -> bytes:
    """Return the message as text, its arrays as lists."""
    fields = msgspec.structs.asdict(message).items()
    return json.dumps(
        {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields},
        allow_nan=False,
    ).encode()


def decode_json(cls: type[Message], data: bytes | memoryview) -> dict[str, Any]:
    """Return what the text says, with lists as arrays."""
    values: dict[str, Any] = json.loads(bytes(data))
    for field in schema_of(cls).fields:
        if field.packed:
            values[field.name] = np.array(values[field.name])
    return values


method(
    task="codec",
    name="pieces",
    cost_s=0.00025,
    bounds=[Bound("value", 0.0), Bound("cpu_s", 4.7e-4, {"array_bytes": (CUT_FROM, 1 << 20)})],
    evidence=EVIDENCE,
    valid={"array_bytes": (CUT_FROM, LARGEST_BYTES)},
    fails="below, threads wake each other up to hand memory over: 256 KiB take 0.6 ms, in one frame 0.3",
)(cut)
