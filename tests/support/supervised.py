"""A running graph as a test sees it from outside: its folder, its events, its processes."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import psutil

from palp_core.graph.messages.builtin import GraphEvent
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from palp_core.graph.node.spec import GRAPH_EVENTS
from palp_core.graph.transport.requester_socket import ask
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.palp import PATIENCE_S, Palp

TALK = '''
import ctypes, os, signal, sys
from palp_core import Node, Params, Progress, Pub, every


class TalkParams(Params):
    deed: str = ""
    rate_hz: float = 20.0


class Talk(Node):
    """Says something, and does a deed at its third tick."""

    params: TalkParams
    progress = Pub(Progress)
    ticks = 0

    @every("rate_hz")
    def tick(self):
        self.ticks += 1
        self.progress.publish(Progress(stamp_ns=0, phase="ticks", done_count=self.ticks, total_count=10**9))
        if self.ticks == 3 and self.params.deed:
            getattr(self, self.params.deed)()

    def mutter(self):
        print("its last words (é), without an end of line", end="")
        os.kill(os.getpid(), signal.SIGKILL)

    def crash(self):
        ctypes.string_at(0)

    def flood(self):
        os.write(1, b"from below\\n")
        os.write(2, b"an error from below\\n")
        for number in range(20_000):
            print("line", number)
        raise ValueError("enough")
'''

LAUNCH = """
graph: talk
clock: wall
args:
  deed: {default: "", help: of the talker}
nodes:
  talker: {run: "nodes.talk:Talk", params: {deed: $(var deed)}}
  other: {run: "nodes.talk:Talk"}
"""


def write_files(folder: Path, files: Mapping[str, str]) -> None:
    """Write the files of a workspace."""
    for name, text in files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")


class Running:
    """The graph that a command line has started, as a test sees it from outside."""

    def __init__(self, palp: Palp) -> None:
        self.palp = palp

    @functools.cached_property
    def folder(self) -> Path:
        (record,) = (self.palp.runtime_dir / "palp").glob("*/graph.json")
        return record.parent

    @property
    def record(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.folder / "graph.json").read_bytes())
        return found

    @property
    def nodes(self) -> list[str]:
        """The nodes of its record, by name."""
        return [node["name"] for node in self.record["nodes"]]

    def pid(self, node: str) -> int:
        return int(next(entry["pid"] for entry in self.record["nodes"] if entry["name"] == node))

    def process(self, node: str) -> psutil.Process:
        return psutil.Process(self.pid(node))

    def ask(self, node: str, op: str, **fields: Any) -> dict[str, Any]:
        """Ask a node or the launcher ("graph")."""
        reply = ask(f"ipc://{self.folder}/{node}.srv", {"op": op, "node": node, **fields}, PATIENCE_S)
        assert reply is not None, f"{node} does not answer"
        return reply

    def events(self) -> list[GraphEvent]:
        frames = self.ask("graph", "history", topic=GRAPH_EVENTS, first=1, last=1000)["frames"]
        return [decode(GraphEvent, parse(frame).payload) for frame in frames]

    def until(self, condition: Callable[[], object]) -> None:
        """Wait for a condition: look again at each event and at each heartbeat of their topic."""
        news = SubscriberSocket({GRAPH_EVENTS: f"ipc://{self.folder}/graph.pub"})
        try:
            while not condition():
                assert news.wait(PATIENCE_S), "the graph is silent"
                news.receive()
        finally:
            news.close()

    def wait_for(self, kind: str, node: str) -> GraphEvent:
        """Wait for an event of a node; return it."""
        found: list[GraphEvent] = []

        def came() -> bool:
            found[:] = [one for one in self.events() if (one.kind, one.node) == (kind, node)]
            return bool(found)

        self.until(came)
        return found[0]

    def wait_for_epoch(self, node: str, topic: str, epoch: int) -> None:
        """Wait for a message of a node's process of that number."""
        reader = SubscriberSocket({topic: f"ipc://{self.folder}/{node}.pub"})
        try:
            while not any(parse(raw).epoch == epoch and parse(raw).payload for raw in reader.receive()):
                assert reader.wait(PATIENCE_S)
        finally:
            reader.close()

    def log(self, name: str) -> str:
        return (self.folder / "log" / f"{name}.log").read_text()
