"""How fast bags are written and read compared with ``mcap``, in one run.

Every ratio is of the same bytes on the same machine in interleaved rounds, above 1 where palp is faster:
recording whole wire frames (parsed, accounted for) against the bare ``mcap`` writer given ready payloads;
reading typed messages against the bare ``mcap`` reader with CRCs plus a msgpack decode. The two writers are
also compared alone, each closing a chunk every half second of the recording, as a bag does: bytes, and what
``palp bag recover`` gets of a file without end whose first chunk is damaged.

Run: .venv/bin/python benchmarks/bags.py [--quick] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import msgpack
import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter

from palp_core.errors import BagError
from palp_core.graph.bag.mcap.file_reader import FileReader
from palp_core.graph.bag.mcap.file_writer import FileWriter
from palp_core.graph.bag.mcap.records import Channel, Schema
from palp_core.graph.bag.reader import read
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.recover import recover
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.frame import pack
from palp_core.graph.messages.topic import Topic

BLOCK_NS, CHUNK_MESSAGES = 2_000_000, 250  # half a second
NAME = "/torque/block"
SCHEMA = {
    "title": "TorqueBlock",
    "type": "object",
    "properties": {
        "stamp_ns": {"type": "integer"},
        "over_phantom": {"type": "boolean"},
        "torque_n_m": {"type": "string", "contentEncoding": "base64", "x-dtype": "<f8"},
    },
}
TOPIC = Topic(name=NAME, type="TorqueBlock", type_hash=f"{7:016x}", json_schema=SCHEMA)


def torque_frames(count: int, samples: int = 2) -> list[tuple[int, bytes]]:
    """Return wire frames of torque blocks with the noise of a 16-bit converter."""
    torque_n_m = np.round(np.random.default_rng(1).normal(size=(count, samples)) * 1e3) * 1e-6
    frames = []
    for i in range(count):
        message = {"stamp_ns": i * 2_000_000, "over_phantom": True, "torque_n_m": torque_n_m[i].tobytes()}
        payload = msgpack.packb(message)
        frames.append((i * 2_000_000, pack(NAME.encode(), 0, 0, i + 1, i * 2_000_000, 7, payload)))
    return frames


def timed(work: Callable[[], Any]) -> float:
    """Return the seconds that a piece of work takes."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def record(folder: Path, frames: list[tuple[int, bytes]]) -> None:
    """Record frames with palp."""
    shutil.rmtree(folder, ignore_errors=True)
    with BagRecorder(BagWriter(folder), [TOPIC]) as recorder:
        for now_ns, frame in frames:
            recorder(now_ns, frame)


def record_mcap(path: Path, frames: list[tuple[int, bytes]]) -> None:
    """Write the payloads with the bare mcap writer."""
    offset = len(NAME) + 33
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("", "bare")
        schema = writer.register_schema("TorqueBlock", "jsonschema", json.dumps(SCHEMA).encode())
        channel = writer.register_channel(NAME, "msgpack", schema)
        for sequence, (now_ns, frame) in enumerate(frames, start=1):
            writer.add_message(channel, now_ns, frame[offset:], now_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def read_mcap(path: Path) -> None:
    """Read with the bare mcap reader, CRCs checked, and decode with msgpack."""
    with path.open("rb") as file:
        for _, _, message in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False):
            msgpack.unpackb(message.data)


def exhaust(bag: Path) -> None:
    """Read every message of a bag as a typed value."""
    for _ in read(bag):
        pass


def throughput(folder: Path, count: int, rounds: int) -> dict[str, float]:
    """Return writing and reading compared with the others."""
    frames = torque_frames(count)
    work: dict[str, Callable[[], None]] = {
        "record": lambda: record(folder / "palp", frames),
        "record_mcap": lambda: record_mcap(folder / "bare.mcap", frames),
        "read": lambda: exhaust(folder / "palp"),
        "read_mcap": lambda: read_mcap(folder / "palp/palp_0.mcap"),
    }
    took = [{name: timed(do) for name, do in work.items()} for _ in range(rounds)]
    return {
        "record_hz": statistics.median(count / of_round["record"] for of_round in took),
        "read_hz": statistics.median(count / of_round["read"] for of_round in took),
        **{
            f"{name}_ratio": statistics.median(
                of_round[name] / of_round[name.partition("_")[0]] for of_round in took
            )
            for name in work
            if "_" in name
        },
    }


def write_palp(path: Path, payloads: list[bytes]) -> None:
    """Write ready payloads with palp's writer, which closes chunks by time."""
    writer = FileWriter(path)
    writer.add_schema(Schema(1, json.dumps(SCHEMA).encode(), "jsonschema", "TorqueBlock"))
    writer.add_channel(Channel(1, NAME, "msgpack", {}, 1))
    for i, payload in enumerate(payloads):
        if i % CHUNK_MESSAGES == 0:
            writer.tick(i * BLOCK_NS)
        writer.write(1, i + 1, i * BLOCK_NS, i * BLOCK_NS, payload)
    writer.close()


def write_mcap(path: Path, payloads: list[bytes]) -> None:
    """Write ready payloads with mcap's writer, flushed as often."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("", "bare")
        schema = writer.register_schema("TorqueBlock", "jsonschema", json.dumps(SCHEMA).encode())
        channel = writer.register_channel(NAME, "msgpack", schema)
        for i, payload in enumerate(payloads):
            if i % CHUNK_MESSAGES == 0:
                writer.flush()  # type: ignore[no-untyped-call]
            writer.add_message(channel, i * BLOCK_NS, payload, i * BLOCK_NS, i + 1)
        writer.finish()  # type: ignore[no-untyped-call]


def recovered_share(path: Path, count: int) -> float:
    """Return the share of messages that are saved from a file without its end, the first chunk damaged."""
    with FileReader(path) as reader:
        first, last = reader.chunks[0], reader.chunks[-1]
    torn = path.with_suffix(".torn.mcap")
    data = bytearray(path.read_bytes()[: last.offset])
    data[first.offset + first.length // 2] ^= 0xFF
    torn.write_bytes(data)
    shutil.rmtree(path.parent / "saved", ignore_errors=True)
    try:
        return sum(recover(torn, path.parent / "saved").message_count.values()) / count
    except BagError:  # nothing could be saved
        return 0.0


def writers(folder: Path, count: int) -> dict[str, float]:
    """Return the bytes that each writer takes, and the share that is saved of a damaged file."""
    offset = len(NAME) + 33
    payloads = [frame[offset:] for _, frame in torque_frames(count)]
    found: dict[str, float] = {}
    for name, write in (("palp", write_palp), ("mcap", write_mcap)):
        path = folder / f"writer-{name}.mcap"
        write(path, payloads)
        found[f"bytes_{name}"] = path.stat().st_size
        found[f"recovered_{name}"] = recovered_share(path, count)
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="within 40 s")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    options = parser.parse_args()
    count, rounds = (50_000, 3) if options.quick else (200_000, 7)
    with tempfile.TemporaryDirectory() as name:
        result: dict[str, Any] = {**throughput(Path(name), count, rounds), **writers(Path(name), count)}
    if options.json:
        print(json.dumps(result))
        return
    for key, value in result.items():
        print(f"{key:24} {value:.4g}")


if __name__ == "__main__":
    main()
