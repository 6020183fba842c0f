"""Clients of a few lines that know only ZeroMQ and msgpack read a topic, publish into one, call a service."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import pytest

from palp_core.graph.messages.frame import HEADER_BYTES, VERSION, Kind, pack, parse
from palp_core.graph.process.node_services import NodeServices
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.palp import PATIENCE_S, ROOT, end, own_palp

EXAMPLE = ROOT / "examples" / "interop"

Client = Callable[..., "subprocess.CompletedProcess[str]"]


def node_with(folder: Path, *packages: str) -> str:
    """Install packages, or what ``package.json`` in the folder names; return where Node.js is.

    Without Node.js, npm or a source of packages, skip the test.
    """
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("needs node and npm: apt-get install npm")
    quiet = ("--ignore-scripts", "--no-audit", "--no-fund", "--prefer-offline", "--fetch-retries=0")
    try:
        done = subprocess.run(
            [npm, "install", *quiet, *packages],
            cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        pytest.skip(f"needs packages of Node.js: npm install has not ended within {PATIENCE_S:g} s")
    if done.returncode:
        pytest.skip(f"needs packages of Node.js: {done.stderr.strip().partition(chr(10))[0]}")
    return node


@pytest.fixture(scope="module")
def graph() -> Iterator[Path]:
    with running() as record:
        yield record


@contextlib.contextmanager
def running() -> Iterator[Path]:
    """The example's graph, running; yields its graph.json."""
    with own_palp() as palp:
        process = palp.start("launch", EXAMPLE / "launch" / "interop.yaml")
        while not (found := list(palp.runtime_dir.glob("palp/*/graph.json"))):
            with contextlib.suppress(subprocess.TimeoutExpired):
                raise AssertionError(f"ended with {process.wait(0.02)}: {process.communicate()}")
        _until_it_runs(found[0])
        yield found[0]
        end(process, signal.SIGTERM)


def _until_it_runs(record: Path) -> None:
    topics = {entry["name"]: entry["publish"] for entry in json.loads(record.read_text())["topics"]}
    reader = SubscriberSocket({"/sensor/torque": topics["/sensor/torque"]})
    try:
        while not any(parse(frame).kind == Kind.DATA for frame in reader.receive()):
            assert reader.wait(PATIENCE_S)
    finally:
        reader.close()


def _python(client: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    # -I: the client sees no folder of the project, only what is installed
    return _run([sys.executable, "-I", EXAMPLE / "python" / f"{client}.py", *arguments], dict(os.environ))


def _run(command: list[object], environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command],
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


@pytest.fixture(scope="module")
def node_client(tmp_path_factory: pytest.TempPathFactory) -> Client:
    """Runs the Node.js clients, with their packages installed in a temporary folder."""
    folder = tmp_path_factory.mktemp("node")
    shutil.copytree(EXAMPLE / "node", folder, dirs_exist_ok=True)
    node = node_with(folder)
    return lambda client, *arguments: _run([node, folder / f"{client}.mjs", *arguments], dict(os.environ))


def _last(client: Client, graph: Path, count: int) -> tuple[list[int], list[float]]:
    """Read some messages of the sensor; return their sequences and the last torque."""
    done = client("read_topic", graph, "/sensor/torque", count)
    assert done.returncode == 0, done.stderr
    lines = [channel.split(" ", 1) for channel in done.stdout.splitlines()]
    return [int(sequence) for sequence, _ in lines], json.loads(lines[-1][1])["torque_n_m"]


def _converse(client: Client, graph: Path) -> None:
    sequences, torque_n_m = _last(client, graph, 5)
    assert sequences == list(range(sequences[0], sequences[0] + 5))
    assert torque_n_m == [0.0] * 6
    published = client("publish", graph, "/sensor/load", '{"torque_n_m": 0.25}')
    assert json.loads(published.stdout) == {"sequence": 1}, published.stderr
    assert _last(client, graph, 2)[1] == [0.25] * 6
    called = client("call_service", graph, "/sensor/tare", "{}")
    assert json.loads(called.stdout) == {"offset_n_m": 0.25}, called.stderr
    assert _last(client, graph, 2)[1] == [0.0] * 6


def test_python_clients_read_publish_and_call(graph: Path) -> None:
    _converse(_python, graph)


@pytest.mark.nightly
def test_node_clients_read_publish_and_call(node_client: Client) -> None:
    with running() as record:
        _converse(node_client, record)


def test_clients_are_told_what_is_wrong(graph: Path) -> None:
    undeclared = _python("publish", graph, "/monitor/torque", "{}")
    assert undeclared.returncode == 1
    assert "external: true" in undeclared.stderr
    wrong = _python("publish", graph, "/sensor/load", '{"torque_n_m": "much"}')
    assert "torque_n_m" in wrong.stderr
    unknown = _python("call_service", graph, "/sensor/zero", "{}")
    assert "tare" in unknown.stderr
    assert _last(_python, graph, 2)[1] == [0.0] * 6


def test_the_documented_header_is_what_is_sent() -> None:
    text = (ROOT / "docs" / "reference" / "wire.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| ([ui]\d+) \| ([a-z ]+) \|", text, flags=re.MULTILINE)
    codes = {"u8": "<B", "u16": "<H", "u32": "<I", "u64": "<Q", "i64": "<q"}
    frame = pack(b"/a/b", Kind.DATA, 2, 3, -4, 5, b"payload")
    header = frame[frame.index(0) + 1 :]
    read = {name: struct.unpack_from(codes[size], header, int(offset))[0] for offset, size, name in rows}
    expected = {"version": VERSION, "kind": 0, "flags": 0, "epoch": 2, "sequence": 3, "stamp": -4}
    assert read == {**expected, "type hash": 5}
    assert f"| {HEADER_BYTES} | | payload |" in text
    assert header[HEADER_BYTES:] == b"payload"
    shown = re.search(r"^/arm/angle ([0-9a-f |]+)\.\.\.$", text, flags=re.MULTILINE)
    assert shown is not None
    sent = pack(
        b"/arm/angle", Kind.DATA, 0, 7, 250_000_000, 0x1F2E3D4C5B6A7988, msgpack.packb({"angle_rad": 0.5})
    )
    assert sent.startswith(b"/arm/angle" + bytes.fromhex(shown[1].replace("|", "")))
    named = re.search(r"(\d [a-z]+(?:, \d [a-z]+)+) \|$", text, flags=re.MULTILINE)
    assert named is not None
    assert named[1] == ", ".join(f"{kind.value} {kind.name.lower()}" for kind in Kind)


def test_the_documented_operations_are_those_of_a_node() -> None:
    text = (ROOT / "docs" / "reference" / "wire.md").read_text(encoding="utf-8")
    table = text.partition("| op | with | reply |")[2].partition("\n\n")[0]
    named = {name for row in table.splitlines() for name in re.findall(r"`(\w+)`", row[: row.find("|", 2)])}
    methods = {name for name in vars(NodeServices) if not name.startswith("_") and name != "operations"}
    assert methods <= named
