"""An interrupted run in lockstep goes on from its last checkpoint as if nothing had happened."""

from __future__ import annotations

import errno
import math
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.errors import GraphError, PalpError
from palp_core.graph.bag.diff import diff_bags
from palp_core.graph.bag.reader import read
from palp_core.graph.launch import checkpoint_file, checkpoints, lockstep_checkpoints
from palp_core.graph.launch.diagnostics import Diagnostics
from palp_core.graph.launch.graph import Graph
from palp_core.graph.messages.frame import parse
from palp_core.graph.supervision.interrupt import Interrupted
from tests.graph.launch.killed import launch_and_end, launch_and_kill
from tests.support.palp import Palp
from tests.support.rig_session import ComposedGraph

NODES = '''
import numpy as np
from palp_core import Alarm, Message, Node, Params, Progress, Pub, Qos, State, Sub, every, on


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

    def on_restore(self, *, alone):
        self.log.warning("goes on, alone: %s", alone)

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
    """Answers late, by an alarm, with what it has heard and noise of its own."""

    state: EchoState
    step = Sub(Step)
    stop = Sub(Step)
    answer = Pub(Step)
    late = Alarm()

    def on_resume(self):
        self.answer.publish(Step(index=-2, value=0.0))  # a successor has a word to say
        self.rng.normal()

    @on(step)
    def hear(self, step):
        self.state.heard.append(step.value)
        self.state.count += 1
        self.late.set(self.now_ns() + 5_000_000)

    @on(stop)
    def rest(self, stop):
        self.state.heard = self.state.heard[-3:]

    @on(late)
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

    @on(Echo.late)
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
  clock: {default: sim}
  rate: {default: 20.0}
nodes:
  walker: {run: walk.py:Walker, params: {count: $(var count), rate_hz: $(var rate)}, on_exit: shutdown}
  echo: {run: walk.py:Echo, inputs: {step: walker/step, stop: walker/stop}}
checkpoint: {file: $(var out)/checkpoint, after: walker/stop, nodes: [walker, echo]}
"""

Frames = dict[str, list[bytes]]


class Killed(BaseException):
    """In place of a power cut, within one process."""


@pytest.fixture(autouse=True)
def every_checkpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each that is due is written, however little would be lost."""
    monkeypatch.setattr(checkpoints, "EVERY_NS", 0)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    module = f"walk_{tmp_path.name}"  # one process imports a module of a name but once
    (tmp_path / f"{module}.py").write_text(NODES)
    path = tmp_path / "walk.yaml"
    path.write_text(LAUNCH.replace("walk.py", f"{module}.py"))
    return path


def run(
    file: Path,
    *,
    until: int = 0,
    asked_at: int = 0,
    resume: bool = False,
    record: Path | None = None,
    swap_at_s: float = 0.0,
    swap_to: str = "",
    **args: object,
) -> Frames:
    """Return every frame of a run, by topic, up to a step at which it is killed, or asked to end."""
    frames: Frames = defaultdict(list)

    def observe(_: int, frame: bytes) -> None:
        found = parse(frame)
        if found.topic == "/walker/step" and found.sequence == until:
            raise Killed
        if found.topic == "/walker/step" and found.sequence == asked_at:
            graph._interrupt.request()
        frames[found.topic].append(frame)

    graph = ComposedGraph(
        file, observe=observe, resume=resume, record=record, out=file.parent / "out", **args
    )
    try:
        with graph:
            if swap_at_s:
                graph.plan_swap(swap_at_s, "echo", swap_to or f"walk_{file.parent.name}.py:Other")
            graph.run()
    except Killed:
        assert until
    except Interrupted:
        assert asked_at
    return frames


def joined(before: Frames, after: Frames) -> Frames:
    """Return what was published up to the checkpoint, and then."""
    found: Frames = {}
    for name in {*before, *after}:
        first = parse(after[name][0]).sequence if name in after else math.inf
        found[name] = [frame for frame in before.get(name, []) if parse(frame).sequence < first]
        found[name] += after.get(name, [])
    return found


@pytest.mark.parametrize("until", [1, 6, 11, 13, 26, 40])
def test_a_run_that_was_killed_publishes_what_it_would_have_published(until: int, file: Path) -> None:
    whole = run(file)
    assert not (file.parent / "out" / "checkpoint").exists()
    before = run(file, until=until)
    assert joined(before, run(file, resume=True)) == whole


def test_a_run_may_be_interrupted_while_it_goes_on(file: Path) -> None:
    whole = run(file)
    first = run(file, until=13)
    second = run(file, until=27, resume=True)
    third = run(file, resume=True)
    assert joined(first, joined(second, third)) == whole


@pytest.mark.parametrize("asked_at", [3, 5, 12, 28])
def test_a_run_that_is_asked_to_end_goes_on_at_the_next_step(
    asked_at: int, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the checkpoints only the first is written, and what was due then at the end."""
    whole = run(file)
    monkeypatch.setattr(checkpoints, "EVERY_NS", sys.maxsize)
    before = run(file, asked_at=asked_at)
    after = run(file, resume=True)
    assert joined(before, after) == whole
    assert parse(after["/walker/step"][0]).sequence == (asked_at + 1 if asked_at >= 5 else 1)


def test_what_is_due_is_written_once_in_a_while(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine are due, one in 250 ms on the run's clock; the machine's goes by it."""
    monkeypatch.setattr(checkpoints, "EVERY_NS", 700_000_000)
    graph = ComposedGraph(file, out=file.parent / "out")
    monkeypatch.setattr(checkpoints, "monotonic_ns", lambda: graph._now_ns())
    monkeypatch.setattr(lockstep_checkpoints, "monotonic_ns", lambda: graph._now_ns())
    with graph:
        graph.run()
    assert graph.checkpoints.cost.count == 3  # as it begins, and then at 0.7 and 1.4 of 2 s
    assert not (file.parent / "out" / "checkpoint").exists()


def test_how_often_it_is_written_down_is_no_part_of_a_run(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    often = run(file)
    monkeypatch.setattr(checkpoints, "EVERY_NS", sys.maxsize)
    assert run(file) == often


def test_the_bag_gets_another_file_and_holds_every_message_once(file: Path, tmp_path: Path) -> None:
    run(file, record=tmp_path / "whole")
    run(file, until=13, record=tmp_path / "bag")
    run(file, resume=True, record=tmp_path / "bag")
    assert sorted(path.name for path in (tmp_path / "bag").glob("*.mcap")) == ["bag_0.mcap", "bag_1.mcap"]
    found = diff_bags(tmp_path / "whole", tmp_path / "bag")
    events = found.pop("/graph/events")
    assert events.count_b == events.count_a + 1  # that it was interrupted is said there
    for name, topic in found.items():
        assert topic.first is None, name
        assert topic.count_a == topic.count_b == topic.equal_count, name


def test_a_bag_that_lacks_messages_is_not_gone_on_with(file: Path, tmp_path: Path) -> None:
    run(file, until=13, record=tmp_path / "bag")
    part = tmp_path / "bag" / "bag_0.mcap"
    data = bytearray(part.read_bytes())
    data[data.index(b"zstd") + 20] ^= 0xFF
    part.write_bytes(data)
    with pytest.raises(PalpError, match="lacks messages from before the interruption"):
        run(file, resume=True, record=tmp_path / "bag")


def test_the_same_bag_must_be_named(file: Path, tmp_path: Path) -> None:
    run(file, until=13, record=tmp_path / "bag")
    with pytest.raises(GraphError, match=r"recorded into .*/bag: --record .*/bag goes on with it"):
        run(file, resume=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda file: {"seed": 4}, "the seed was 3, and is 4"),
        (lambda file: {"count": 41}, "argument count was 40, and is 41"),
        (
            lambda file: reword(file, "on_exit: shutdown", "on_exit: shutdown, output: screen"),
            "node 'walker': output",
        ),
        (lambda file: reword(file, ".py:Echo", ".py:Other"), "node 'echo': run"),
        (lambda file: edit(file, "[-3:]", "[-4:]"), "the software has changed: walk_test"),
    ],
)
def test_another_run_is_not_taken_for_the_interrupted_one(
    change: Callable[[Path], dict[str, object] | None], words: str, file: Path
) -> None:
    run(file, until=13)
    kept = (file.parent / "out" / "checkpoint").read_bytes()
    args: dict[str, Any] = change(file) or {}
    with pytest.raises(GraphError) as refused:
        run(file, resume=True, **args)
    assert words in str(refused.value)
    assert "resume it as it was, or begin anew" in str(refused.value)
    assert (file.parent / "out" / "checkpoint").read_bytes() == kept


def reword(file: Path, old: str, new: str) -> None:
    file.write_text(file.read_text().replace(old, new))


def edit(file: Path, old: str, new: str) -> None:
    reword(next(file.parent.glob("walk_*.py")), old, new)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda data: b"", "is no checkpoint of a run"),
        (lambda data: data[: len(data) // 2], "is torn"),
        (lambda data: data[:-1], "is torn"),
        (lambda data: data[:200] + bytes([data[200] ^ 0xFF]) + data[201:], "is torn"),
        (lambda data: data.replace(b"checkpoint 1\n", b"checkpoint 9\n"), "another version of palp"),
        (lambda data: b"a picture of a cat", "is no checkpoint of a run"),
    ],
)
def test_a_torn_checkpoint_is_refused(spoil: Callable[[bytes], bytes], words: str, file: Path) -> None:
    run(file, until=13)
    path = file.parent / "out" / "checkpoint"
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(GraphError, match=words):
        run(file, resume=True)


def test_what_ended_or_never_began_cannot_be_resumed(file: Path) -> None:
    for ended in range(2):
        with pytest.raises(GraphError, match="nothing to resume: there is no checkpoint"):
            run(file, resume=True)
        assert (file.parent / "out").exists() == bool(ended)
        run(file)
    reword(file, "checkpoint:", "# ")
    reword(file, '  out: {default: ""}\n', "")
    with pytest.raises(GraphError, match="the launch file writes no checkpoint"):
        Graph(file, resume=True, compose=True).__enter__()


def test_resume_may_be_written_like_an_argument(file: Path, palp: Palp) -> None:
    done = palp.here("launch", file, f"out:={file.parent / 'out'}", "resume:=true")
    assert done.returncode == 2
    assert "nothing to resume: there is no checkpoint" in done.stderr


def test_a_checkpoint_of_a_blinded_run_shows_nothing_of_it_and_goes_on_all_the_same(file: Path) -> None:
    whole = run(file)
    run(file, until=13)
    kept = file.parent / "out" / "checkpoint"
    shown = kept.read_bytes()
    reword(file, "graph: walk", "graph: walk\nblind: true")
    kept.unlink()
    before = run(file, until=13)
    sealed = kept.read_bytes()
    words = (b"walker", b"heard", b"/walker/step", b"palp checkpoint")
    assert all(word in shown and word not in sealed.partition(b"\n")[2] for word in words)
    assert kept.stat().st_mode & 0o077 == 0
    after = run(file, resume=True)
    for topic in ("/walker/step", "/echo/answer"):
        assert joined(before, after)[topic] == whole[topic]
    kept.write_bytes(sealed[:-9])
    with pytest.raises(GraphError, match="is torn"):
        run(file, resume=True)


def test_an_unfinished_run_is_not_begun_anew_unasked(file: Path) -> None:
    run(file, until=13)
    kept = (file.parent / "out" / "checkpoint").read_bytes()
    with pytest.raises(GraphError, match="is of an unfinished run: --resume goes on with it; remove it to"):
        run(file)
    assert (file.parent / "out" / "checkpoint").read_bytes() == kept


def test_two_do_not_go_on_with_one_run(file: Path) -> None:
    run(file, until=13)
    args = {"resume": True, "out": file.parent / "out"}
    with ComposedGraph(file, **args), pytest.raises(GraphError, match="goes on already"):
        ComposedGraph(file, **args).__enter__()


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(
    file: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    whole = run(file)
    write, count = checkpoint_file.write_checkpoint, 0

    def full(*args: Any, **given: Any) -> int:
        nonlocal count
        count += 1
        if count > 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(*args, **given)

    said: list[str] = []
    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "write_checkpoint", full)
        patch.setattr(Diagnostics, "tell", lambda _, text, *__: said.append(text))
        before = run(file, until=30)
    assert count > 3
    assert [record.message for record in caplog.records if "No space left" in record.message] == [
        f"no checkpoint can be written to {file.parent / 'out' / 'checkpoint'}: No space left on device; "
        "the run goes on, and could be resumed where the last one was written"
    ]
    where = file.parent / "out" / "checkpoint"
    in_view = f"no checkpoint can be written to {where}: No space left on device"
    assert said == [in_view]
    after = run(file, resume=True)
    assert parse(after["/walker/step"][0]).sequence == 6  # the second one was written after five steps
    assert joined(before, after) == whole


def test_the_class_that_had_taken_over_must_be_as_it_was(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.py"
    other.write_text(next(file.parent.glob("walk_*.py")).read_text())
    run(file, swap_at_s=0.62, swap_to=f"{other}:Other", until=33)
    other.write_text(other.read_text() + "print('edited')\n")
    with pytest.raises(GraphError, match=r"the software has changed: .*other"):
        run(file, resume=True)


def test_a_node_that_had_taken_over_goes_on(file: Path) -> None:
    whole = run(file, swap_at_s=0.62)
    before = run(file, swap_at_s=0.62, until=33)
    assert joined(before, run(file, resume=True)) == whole


@pytest.mark.parametrize("compose", [True, False])
def test_a_launcher_killed_by_sigkill_leaves_a_run_that_goes_on(
    compose: bool, file: Path, palp: Palp
) -> None:
    """What it ends with is the state of the walk, told by its bag."""
    out = file.parent / "out"
    run(file, record=file.parent / "whole")
    bag = file.parent / "bag"
    launch_and_kill(palp, file, "/walker/step", 23, f"out:={out}", compose=compose, record=str(bag))
    resume(file, bag, compose=not compose)  # in processes and composed it is the same run
    found = diff_bags(file.parent / "whole", bag)
    assert all(topic.first is None for name, topic in found.items() if name != "/graph/events")
    assert not list(out.iterdir())


def resume(file: Path, bag: Path, *, compose: bool) -> None:
    """Go on with a run that is recorded."""
    kind, path = ComposedGraph if compose else Graph, list(sys.path)
    with kind(file, out=file.parent / "out", resume=True, record=bag) as graph:
        graph.run()
    sys.path[:] = path


def test_processes_asked_to_end_are_all_at_rest_first(file: Path, palp: Palp) -> None:
    """However the end finds them, nothing that was computed is lost, and the bag is a whole run's."""
    out, bag = file.parent / "out", file.parent / "bag"
    run(file, record=file.parent / "whole")
    launch_and_end(palp, file, "/walker/step", 23, f"out:={out}", compose=False, record=str(bag))
    resume(file, bag, compose=False)
    found = diff_bags(file.parent / "whole", bag)
    assert all(topic.first is None for name, topic in found.items() if name != "/graph/events")
    first, second = (
        [m.sequence for m in read(part, ["/walker/step"])] for part in sorted(bag.glob("*.mcap"))
    )
    assert (first, second) == ([*range(1, 24)], [*range(24, 41)])


def test_on_the_wall_clock_the_named_nodes_go_on_with_what_they_were(file: Path, palp: Palp) -> None:
    """Killed somewhere, it walks on from its last stop, as the same walk in simulated time does."""
    out, bag = file.parent / "out", file.parent / "bag"
    words = (f"out:={out}", "clock:=wall", "rate:=100.0", "count:=60")
    launch_and_kill(palp, file, "", 2, *words, compose=False)
    done = palp.here("launch", file, *words, "--record", bag, "--resume")
    assert done.returncode == 0, done.stderr
    assert "goes on, alone: True" in done.stderr
    walked = list(read(bag, ["/walker/step"]))
    first = walked[0].value.index
    assert first >= 5
    assert first % 5 == 0
    whole = [decode_step(frame) for frame in run(file, count=60)["/walker/step"]]
    assert [(message.value.index, message.value.value) for message in walked] == whole[first:]
    assert walked[0].publish_ns > first * 10_000_000  # the graph's clock goes on
    heard = [message.value.index for message in read(bag, ["/echo/answer"])]
    assert heard[0] > first  # it has heard all steps before, too
    assert not list(out.iterdir())


def decode_step(frame: bytes) -> tuple[int, float]:
    found = msgspec.msgpack.decode(parse(frame).payload)
    return found["index"], found["value"]
