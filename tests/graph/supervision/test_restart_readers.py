"""A restarted node speaks when its readers listen again, and no later than it has said it would wait."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from pathlib import Path

import msgpack
import pytest

from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.palp import PATIENCE_S, Palp, end, wait_for_line
from tests.support.supervised import Running
from tests.support.toys import Hostile

BURST = 200  # far more than the publisher keeps

NODES = f"""
import os
from palp_core import Message, Node, Params, Progress, Pub, State, Sub, every, on


class Word(Message):
    life: int
    number: int


class Counts(State):
    by_life: dict[int, int] = {{}}


class SourceParams(Params):
    rate_hz: float = 20.0


class Source(Node):
    params: SourceParams
    word = Pub(Word)

    def on_activate(self):
        for number in range({BURST}):
            self.word.publish(Word(life=os.getpid(), number=number))

    @every("rate_hz")
    def end(self):
        self.word.publish(Word(life=os.getpid(), number=-1))


class Sink(Node):
    state: Counts
    word = Sub(Word)
    count = Pub(Word)
    progress = Pub(Progress)

    @on(word)
    def take(self, word):
        by_life = self.state.by_life
        if word.number >= 0:
            by_life[word.life] = by_life.get(word.life, 0) + 1
            return
        self.count.publish(Word(life=word.life, number=by_life.get(word.life, 0)))
        self.progress.publish(Progress(stamp_ns=0, phase="words", done_count=1, total_count=10**9))
"""

LAUNCH = """
graph: burst
clock: wall
nodes:
  source: {run: "nodes.burst:Source", restart: {when: on_failure, backoff_s: 0.05}}
  sink: {run: "nodes.burst:Sink", inputs: {word: source/word}}
"""


def beats_heard(reader: SubscriberSocket, epoch: int, beats: int) -> None:
    """Wait until the source's new process has gone on turning for a while: so many heartbeats."""
    while beats:
        assert reader.wait(PATIENCE_S)
        frames = [parse(raw) for raw in reader.receive()]
        beats = max(beats - sum(f.epoch == epoch and f.kind != Kind.DATA for f in frames), 0)


def counted(graph: Running, life: int) -> int:
    """How many words of a process of the source have reached the sink, when it has said its last."""
    reader = SubscriberSocket({"/sink/count": f"ipc://{graph.folder}/sink.pub"})
    try:
        while True:
            assert reader.wait(PATIENCE_S)
            for frame in map(parse, reader.receive()):
                said = msgpack.unpackb(frame.payload) if frame.kind == Kind.DATA else {}
                if said.get("life") == life:
                    return int(said["number"])
    finally:
        reader.close()


def test_the_first_messages_after_a_restart_reach_a_reader_that_is_back_in_time(
    palp: Palp, tmp_path: Path
) -> None:
    hostile = Hostile(palp, tmp_path)
    hostile.write("nodes/burst.py", NODES)
    process = palp.start("launch", hostile.write("launch/burst.yaml", LAUNCH))
    wait_for_line(process, "words: 1/")
    graph = Running(palp)
    assert counted(graph, graph.process("source").pid) == BURST
    noted = graph.folder / "source.readers"
    while not (noted.exists() and "sink" in noted.read_text()):  # with its next heartbeat
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.01)
    sink = graph.process("sink")
    sink.suspend()
    reader = SubscriberSocket({"/source/word": f"ipc://{graph.folder}/source.pub"})
    with contextlib.closing(reader):  # it is there when the new process comes: its heartbeats are few
        os.kill(graph.process("source").pid, signal.SIGKILL)
        beats_heard(reader, epoch=1, beats=3)
        sink.resume()
        restarted = graph.wait_for("restarted", "source")
    killed = "source its process was killed by SIGKILL; restart 1 of "
    assert f"source: [WARNING] [supervisor]: {killed}" in graph.log("merged")
    assert counted(graph, graph.process("source").pid) == BURST
    assert json.loads(restarted.data)["missing"] == []
    end(process, signal.SIGTERM)
    assert palp.all_gone()
