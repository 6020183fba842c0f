"""An interrupted run on the wall clock resumes from its last checkpoint, if it would be the same run."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.errors import GraphError
from palp_core.graph.bag.reader import read
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.launch import checkpoint
from palp_core.graph.launch.checkpoint import Checkpoints, differences
from palp_core.graph.launch.run_journal import JournalEntries
from palp_core.graph.messages.frame import parse
from tests.graph.launch.killed import launch_and_kill
from tests.support.palp import Palp
from tests.support.rig_session import ComposedGraph, check_here

NODES = '''
import numpy as np
from palp_core import Message, Node, Params, Progress, Pub, Qos, State, Sub, every, on


class Step(Message):
    index: int
    value: float


class WalkerParams(Params):
    rate_hz: float = 20.0
    count: int = 40


class WalkerState(State):
    index: int = 0
    value: float = 0.0


class Walker(Node):
    """Walks at random, and says at every fifth step that it has come to a stop."""

    params: WalkerParams
    state: WalkerState
    step = Pub(Step)
    stop = Pub(Step, qos=Qos(durability="transient_local", depth=1))
    progress = Pub(Progress)

    def on_activate(self):
        self.stop.publish(Step(index=self.state.index, value=0.0))

    def on_restore(self):
        self.log.warning("resumes at step %d", self.state.index)

    @every("rate_hz")
    def walk(self):
        state = self.state
        state.value += float(self.rng.normal())
        self.step.publish(Step(index=state.index, value=state.value))
        state.index += 1
        count = self.params.count
        self.progress.publish(Progress(stamp_ns=0, phase="walk", done_count=state.index, total_count=count))
        if state.index % 5 == 0:
            self.stop.publish(Step(index=state.index, value=state.value))
        if state.index == self.params.count:
            self.finish(0)


class EchoState(State):
    heard: list[float] = []
    count: int = 0


class Echo(Node):
    """Answers with what it has heard and noise of its own."""

    state: EchoState
    step = Sub(Step)
    stop = Sub(Step)
    answer = Pub(Step)

    @on(step)
    def hear(self, step):
        self.state.heard.append(step.value)
        self.state.count += 1
        self.reply()

    @on(stop)
    def rest(self, stop):
        self.state.heard = self.state.heard[-3:]

    def reply(self):
        value = sum(self.state.heard) + float(self.rng.normal())
        self.answer.publish(Step(index=self.state.count, value=value))


class OtherState(EchoState):
    @classmethod
    def adopt(cls, old):
        return cls(**old.values)


class Other(Echo):
    """Takes over, and answers otherwise."""

    state: OtherState

    def reply(self):
        self.answer.publish(Step(index=-self.state.count, value=float(self.rng.normal())))
'''

LAUNCH = """
graph: walk
clock: $(var clock)
seed: $(var seed)
args:
  out: {default: ""}
  seed: {default: 3}
  count: {default: 40}
  clock: {default: wall}
  rate: {default: 20.0}
nodes:
  walker: {run: walk.py:Walker, params: {count: $(var count), rate_hz: $(var rate)}, on_exit: shutdown}
  echo: {run: walk.py:Echo, inputs: {step: walker/step, stop: walker/stop}}
checkpoint: {file: $(var out)/checkpoint, after: walker/stop, nodes: [walker, echo]}
"""
KEPT = {"walker": b"the walker", "echo": b"the echo"}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    module = f"walk_{tmp_path.name}"  # one process imports a module of a name but once
    (tmp_path / f"{module}.py").write_text(NODES)
    path = tmp_path / "walk.yaml"
    path.write_text(LAUNCH.replace("walk.py", f"{module}.py"))
    return path


def checked(file: Path, *overrides: str) -> CheckedGraph:
    return check_here(file, [f"out:={file.parent / 'out'}", *overrides])


def kept_in(file: Path) -> Path:
    return file.parent / "out" / "checkpoint"


def write(file: Path, *overrides: str, graph: CheckedGraph | None = None) -> Checkpoints:
    """Write one checkpoint of a run, as one that is killed then leaves it; the run itself is not needed."""
    launched = checked(file, *overrides)
    run = Checkpoints(launched, overrides, resume=False)
    run.begin()
    run.write(graph or launched, KEPT, 7, JournalEntries())
    run.close()
    return run


def resume(file: Path, *overrides: str) -> Checkpoints:
    return Checkpoints(checked(file, *overrides), overrides, resume=True)


def reword(file: Path, old: str, new: str) -> None:
    file.write_text(file.read_text().replace(old, new))


def edit(file: Path, old: str, new: str) -> None:
    reword(next(file.parent.glob("walk_*.py")), old, new)


def test_what_was_written_last_is_what_a_run_resumes_from(file: Path) -> None:
    write(file)
    again = resume(file)
    assert again.resumed is not None
    assert [(node.name, node.kept) for node in again.resumed.nodes] == [
        ("walker", b"the walker"),
        ("echo", b"the echo"),
    ]
    assert (again.resumed.now_ns, again.resumed_count) == (7, 1)
    again.write(checked(file), {"walker": b"the walker, later"}, 9, JournalEntries())
    again.close()
    third = resume(file)
    assert third.resumed is not None
    assert [(node.name, node.kept) for node in third.resumed.nodes] == [("walker", b"the walker, later")]
    assert third.resumed_count == 2
    third.finish()
    third.close()
    assert list((file.parent / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("words", "change", "told"),
    [
        (("seed:=4",), lambda _: None, "the seed was 3, and is 4"),
        (("count:=41",), lambda _: None, "argument count was 40, and is 41"),
        (
            (),
            lambda file: reword(file, "on_exit: shutdown", "on_exit: shutdown, output: screen"),
            "node 'walker' differs in output",
        ),
        ((), lambda file: reword(file, ".py:Echo", ".py:Other"), "node 'echo' differs in run"),
        (
            (),
            lambda file: reword(file, "echo", "other"),
            "the launch file has no node 'echo'\n  the launch file has a node 'other'\n",
        ),
        ((), lambda file: edit(file, "[-3:]", "[-4:]"), r"file walk_test\w*\.py has changed"),
        ((), lambda file: file.with_name("next.py").write_text("LEVEL = 2\n"), r"file next\.py has changed"),
    ],
)
def test_another_run_is_not_taken_for_the_interrupted_one(
    words: Sequence[str], change: Callable[[Path], None], told: str, file: Path
) -> None:
    write(file)
    kept = kept_in(file).read_bytes()
    change(file)
    with pytest.raises(GraphError) as refused:
        resume(file, *words)
    assert re.search(told, str(refused.value))
    assert "resume it as it was, or begin again" in str(refused.value)
    assert kept_in(file).read_bytes() == kept


def test_what_is_not_there_and_what_is_nothing_differ() -> None:
    assert differences({"argument depth": None, "node 'a'": {"output": None}}, {"node 'a'": {}}) == [
        "argument depth was None, and is not there"
    ]
    assert differences(
        {"palp_core": "a", "node 'a'": {"output": None}}, {"palp_core": "b", "node 'a'": {}}
    ) == [
        "palp_core has changed",
        "node 'a' differs in output",
    ]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda data: b"", "is not a checkpoint"),
        (lambda data: data[: len(data) // 2], "is incomplete or damaged"),
        (lambda data: data[:-1], "is incomplete or damaged"),
        (lambda data: data[:200] + bytes([data[200] ^ 0xFF]) + data[201:], "is incomplete or damaged"),
        (lambda data: data.replace(b"checkpoint 2\n", b"checkpoint 9\n"), "another version of palp"),
        (lambda data: b"a picture of a cat", "is not a checkpoint"),
    ],
)
def test_a_torn_checkpoint_is_refused(spoil: Callable[[bytes], bytes], words: str, file: Path) -> None:
    write(file)
    kept_in(file).write_bytes(spoil(kept_in(file).read_bytes()))
    with pytest.raises(GraphError, match=words):
        resume(file)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "run finished, or stopped before its first one"),
        ({"checkpoint": None}, "the launch file writes no checkpoint; add checkpoint: "),
        ({"clock": "sim", "checkpoint": None}, "a run in simulated time cannot resume; run it again"),
    ],
)
def test_what_ended_or_never_began_cannot_resume(given: dict[str, Any], words: str, file: Path) -> None:
    with pytest.raises(GraphError, match=words):
        Checkpoints(msgspec.structs.replace(checked(file), **given), (), resume=True)
    assert not (file.parent / "out").exists()


def test_an_unfinished_run_is_not_replaced_unasked(file: Path) -> None:
    write(file)
    kept = kept_in(file).read_bytes()
    with pytest.raises(GraphError, match="is from an unfinished run; continue it with --resume, or remove"):
        write(file)
    assert kept_in(file).read_bytes() == kept


def test_two_do_not_resume_one_run(file: Path) -> None:
    write(file)
    first = resume(file)
    with pytest.raises(GraphError, match="is in use: its run is still going"):
        resume(file)
    first.close()
    resume(file).close()


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(
    file: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: Any, **__: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    write(file)
    run = resume(file)
    text = f"no checkpoint can be written to {kept_in(file)}: No space left on device"
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write_checkpoint", full)
        told = [run.write(checked(file), {"echo": b"lost"}, 8, JournalEntries()) for _ in range(2)]
    assert told == [text, None]
    assert run.write(checked(file), {"echo": b"later"}, 8, JournalEntries()) == ""
    assert run.write(checked(file), KEPT, 7, JournalEntries()) is None
    assert [record.message for record in caplog.records] == [f"{text}; {checkpoint.RESUMES}"]
    run.close()
    again = resume(file)
    assert again.resumed is not None
    assert again.resumed.now_ns == 7
    again.write(checked(file), {"echo": b"kept"}, 9, JournalEntries())
    again.close()
    assert again.count == 1
    assert resume(file).resumed is not None


@pytest.mark.parametrize("edited", [False, True])
def test_a_class_that_had_taken_over_resumes_if_it_is_as_it_was(file: Path, edited: bool) -> None:
    other = file.parent / f"other_{file.parent.name}.py"
    other.write_text(next(file.parent.glob("walk_*.py")).read_text())
    graph = checked(file)
    (spec,) = (spec for spec in graph.nodes if spec.name == "echo")
    reword(file, f"{next(file.parent.glob('walk_*.py')).name}:Echo", f"{other}:Other")
    (found,) = (node for node in checked(file).nodes if node.name == "echo")
    reword(file, f"{other}:Other", f"{next(file.parent.glob('walk_*.py')).name}:Echo")
    nodes = [found if node is spec else node for node in graph.nodes]
    write(file, graph=msgspec.structs.replace(graph, nodes=nodes))
    if edited:
        other.write_text(other.read_text() + "print('edited')\n")
        with pytest.raises(GraphError, match=r"file .*other"):
            resume(file)
        return
    graph = resume(file).with_successors(inspect_classes)
    assert [node.run for node in graph.nodes if node.name == "echo"] == [found.run]
    assert graph.nodes[0].run == checked(file).nodes[0].run


def test_the_named_nodes_resume_with_what_they_were(file: Path, palp: Palp) -> None:
    """Killed somewhere, it walks on from its last stop, as the same walk in simulated time does."""
    out, bag = file.parent / "out", file.parent / "bag"
    words = (f"out:={out}", "clock:=wall", "rate:=100.0", "count:=60")
    launch_and_kill(palp, file, "", 2, *words)
    done = palp.here("launch", file, *words, "--record", bag, "--resume")
    assert done.returncode == 0, done.stderr
    walked = list(read(bag, ["/walker/step"]))
    first = walked[0].value.index
    assert f"resumes at step {first}" in done.stderr
    assert first >= 5
    assert first % 5 == 0
    whole: list[tuple[int, float]] = []

    def observe(_: int, frame: bytes) -> None:
        if frame.startswith(b"/walker/step\0"):
            step = msgspec.msgpack.decode(parse(frame).payload)
            whole.append((step["index"], step["value"]))

    with ComposedGraph(file, observe=observe, clock="sim", out=file.parent / "whole", count=60) as graph:
        graph.run()
    assert [(message.value.index, message.value.value) for message in walked] == whole[first:]
    assert walked[0].publish_ns > first * 10_000_000  # the graph's clock goes on
    heard = [message.value.index for message in read(bag, ["/echo/answer"])]
    assert heard[0] > first  # it has heard all steps before, too
    assert not list(out.iterdir())
    assert not (file.parent / "whole").exists()  # in simulated time none is written
