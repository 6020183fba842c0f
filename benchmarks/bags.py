"""How fast bags are written and read, and what they weigh, beside other writers and readers in one run.

Every ratio is of the same bytes on the same machine in interleaved rounds, above 1 where palp is faster:
recording whole wire frames (parsed, accounted for) against the bare ``mcap`` writer and ``rosbags``' writer
given ready payloads; reading typed messages against the bare ``mcap`` reader with CRCs plus a msgpack
decode. The two writers are also compared alone, each closing a chunk every half second of the recording, as
a bag does: seconds, bytes, seconds to read it back, and what ``palp bag recover`` gets of a file without end
whose first chunk is damaged. The flood is a publisher of its own process at 20 kHz and 48 bytes over ZeroMQ.
Estimator and policy are driven again from a recording of the simulated rig, and every output compared.

Run: .venv/bin/python benchmarks/bags.py [--quick] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import msgpack
import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosWriter

from palp_core.graph.bag.convert import BagForm, convert
from palp_core.graph.bag.mcap.file_reader import FileReader
from palp_core.graph.bag.mcap.file_writer import FileWriter
from palp_core.graph.bag.mcap.records import Channel, Schema
from palp_core.graph.bag.reader import Bag, read
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.recover import recover
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.launch.graph import Graph
from palp_core.graph.messages.frame import pack
from palp_core.graph.messages.topic import Topic
from palp_core.graph.replay.replay import replay
from palp_core.graph.transport.subscriber_socket import SubscriberSocket

ROOT = Path(__file__).resolve().parents[1]
FLOOD_HZ, FLOOD_BYTES = 20_000, 48
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
PUBLISHER = """
import sys, time
from palp_core.graph.messages.frame import pack
from palp_core.graph.transport.node_sockets import NodeSockets
sockets = NodeSockets(sys.argv[1], sys.argv[1] + "-serve")
rate_hz, count, payload = int(sys.argv[2]), int(sys.argv[3]), bytes(int(sys.argv[4]))
while not sockets.publisher.has_subscribers:
    sockets.poll()
begin_ns, sent = time.monotonic_ns(), 0
while sent < count:
    due = min(count, (time.monotonic_ns() - begin_ns) * rate_hz // 10**9)
    for sequence in range(sent + 1, due + 1):
        sockets.publisher.send(pack(b"/flood/flood", 0, 0, sequence, sequence, 0, payload))
    sent = max(sent, due)
    time.sleep(0.0005)
sockets.publisher.send(pack(b"/flood/flood", 1, 0, count, count, 0))
sockets.close()
"""


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


def record_rosbags(folder: Path, frames: list[tuple[int, bytes]]) -> None:
    """Write the payloads with rosbags' writer, to MCAP."""
    shutil.rmtree(folder, ignore_errors=True)
    offset = len(NAME) + 33
    with RosWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            NAME, "palp_msgs/msg/TorqueBlock", msgdef="int64 x", rihs01="RIHS01_0"
        )
        for now_ns, frame in frames:
            writer.write(connection, now_ns, frame[offset:])


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
    """Return writing and reading beside the others."""
    frames = torque_frames(count)
    took: dict[str, list[float]] = {name: [] for name in ("palp", "mcap", "rosbags", "read", "mcap_read")}
    for _ in range(rounds):
        took["palp"].append(timed(lambda: record(folder / "palp", frames)))
        took["mcap"].append(timed(lambda: record_mcap(folder / "bare.mcap", frames)))
        took["rosbags"].append(timed(lambda: record_rosbags(folder / "ros", frames)))
        took["read"].append(timed(lambda: exhaust(folder / "palp")))
        took["mcap_read"].append(timed(lambda: read_mcap(folder / "palp/palp_0.mcap")))
    best = {name: statistics.median(seconds) for name, seconds in took.items()}
    return {
        "record_hz": count / best["palp"],
        "record_ratio": best["mcap"] / best["palp"],
        "record_ratio_rosbags": best["rosbags"] / best["palp"],
        "read_hz": count / best["read"],
        "read_ratio": best["mcap_read"] / best["read"],
    }


def write_palp(path: Path, payloads: list[bytes]) -> None:
    """Write ready payloads with palp's writer, which closes chunks by time."""
    path.unlink(missing_ok=True)
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
    return sum(recover(torn, path.parent / "saved").message_count.values()) / count


def writers(folder: Path, count: int, rounds: int) -> dict[str, Any]:
    """Compare palp's MCAP writer with mcap's, by turns within each round: median, least and most."""
    offset = len(NAME) + 33
    payloads = [frame[offset:] for _, frame in torque_frames(count)]
    files = {"palp": folder / "writer-palp.mcap", "mcap": folder / "writer-mcap.mcap"}
    write = {"palp": write_palp, "mcap": write_mcap}
    took: dict[str, list[float]] = {f"{what}_{name}": [] for what in ("write", "read") for name in files}
    for turn in range(rounds):
        for name in sorted(files, reverse=bool(turn % 2)):
            took[f"write_{name}"].append(timed(partial(write[name], files[name], payloads)))
            took[f"read_{name}"].append(timed(partial(read_mcap, files[name])))
    found: dict[str, Any] = {
        f"{name}_s": [f(seconds) for f in (statistics.median, min, max)] for name, seconds in took.items()
    }
    for what in ("write", "read"):
        ratios = [a / b for a, b in zip(took[f"{what}_mcap"], took[f"{what}_palp"], strict=True)]
        found[f"{what}_ratio"] = [f(ratios) for f in (statistics.median, min, max)]
    for name, path in files.items():
        found[f"bytes_{name}"] = path.stat().st_size
        found[f"recovered_{name}"] = recovered_share(path, count)
    return found


def flood(folder: Path, seconds: float) -> dict[str, float]:
    """Record a flood from another process; return what was lost and the recorder's share of a core."""
    endpoint, count = f"ipc://{folder}/flood", round(seconds * FLOOD_HZ)
    arguments = [sys.executable, "-c", PUBLISHER, endpoint, str(FLOOD_HZ), str(count), str(FLOOD_BYTES)]
    with subprocess.Popen(arguments) as publisher:
        subscriber = SubscriberSocket({"/flood/flood": endpoint})
        recorder = BagRecorder(BagWriter(folder / "flood-bag"), [Topic(name="/flood/flood")])
        begin_ns, busy_s = time.monotonic_ns(), time.process_time()
        last_ns = begin_ns
        while publisher.poll() is None or subscriber.pending():
            subscriber.wait(0.05)
            now_ns = time.monotonic_ns()
            for frame in subscriber.receive():
                recorder(now_ns - begin_ns, frame)
            if now_ns - last_ns > 50_000_000:
                recorder.tick(now_ns)
                last_ns = now_ns
        busy_s = time.process_time() - busy_s
        summary = recorder.close()
        subscriber.close()
    topic = summary.topics["/flood/flood"]
    return {"record_lost": topic.lost, "flood_count": topic.count, "flood_core_share": busy_s / seconds}


def seek(folder: Path, total_bytes: int, chunk_bytes: int) -> dict[str, float]:
    """Return the time to open a large bag and get the first message from its middle, and memory."""
    bag = folder / f"large{chunk_bytes}"
    payload = np.random.default_rng(2).bytes(8000)
    with BagWriter(bag, compression="none", chunk_bytes=chunk_bytes) as writer:
        stream = writer.stream(Stream(topic=Topic(name="/large")))
        count = total_bytes // len(payload)
        for i in range(count):
            writer.write(stream, i + 1, i, i, struct.pack(">BHI", 0xC5, len(payload) - 3, i) + payload[7:])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.perf_counter()
    with Bag(bag) as opened:
        next(iter(opened.recorded(start_ns=count // 2)))
        took = time.perf_counter() - begin
        chunks = len(opened.files[0].chunks)
        for _ in opened.recorded():
            pass
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    shutil.rmtree(bag)
    return {"open_and_seek_s": took, "chunks": chunks, "memory_grown_mb": grown_mb}


def weight(folder: Path, seconds: int) -> dict[str, float]:
    """Return bytes per torque sample at 1000 Hz in blocks of 2, beside a ROS 2 bag of the same content."""
    record(folder / "weight", torque_frames(seconds * 500))
    convert(folder / "weight", folder / "weight-ros2", BagForm.ROS2)
    sizes = [sum(f.stat().st_size for f in (folder / n).glob("*.mcap")) for n in ("weight", "weight-ros2")]
    return {
        "bytes_per_sample": sizes[0] / (seconds * 1000),
        "bytes_per_sample_ros2": sizes[1] / (seconds * 1000),
    }


def replays(folder: Path, seconds: float, rounds: int) -> dict[str, float]:
    """Return how fast estimator and policy are driven again from a recording, to the same bytes each time.

    Raises:
        SystemExit: An output differs from the recorded one.
    """
    arguments = ["training:=1", "trials:=100", f"out:={folder}/out"]
    with Graph(ROOT / "launch/sim.yaml", compose=True, overrides=arguments, record=folder / "rig") as graph:
        graph.run(seconds)
    factors, compared = [], 0
    for _ in range(rounds):
        done = replay(folder / "rig", ["estimator", "policy"], ROOT)
        for node in done:
            if node.divergence is not None:
                raise SystemExit(f"{node.node} differs: {node.divergence.topic} {node.divergence.what}")
        compared = sum(node.compared for node in done)
        factors.append(seconds / sum(node.wall_s for node in done))
    return {
        "replay_realtime_factor": statistics.median(factors),
        "replay_realtime_factor_least": min(factors),
        "replay_equal_outputs": compared,
        "replay_rounds": rounds,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="within 40 s")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    options = parser.parse_args()
    quick = options.quick
    result: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        large = 200_000_000 if quick else 1_000_000_000
        result["seek"] = seek(folder, large, 1 << 16)
        result["seek_many_chunks"] = seek(folder, large, large // 40_000)
        result |= throughput(folder, 50_000 if quick else 200_000, 3 if quick else 7)
        result["writers"] = writers(folder, 50_000 if quick else 200_000, 3 if quick else 7)
        result |= flood(folder, 5.0 if quick else 60.0)
        result |= weight(folder, 60)
        result |= replays(folder, 200.0 if quick else 600.0, 3 if quick else 10)
    if options.json:
        print(json.dumps(result))
        return
    for key, value in result.items():
        print(f"{key:24} {value if isinstance(value, dict) else f'{value:.4g}'}")


if __name__ == "__main__":
    main()
