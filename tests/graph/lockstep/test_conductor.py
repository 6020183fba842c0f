"""Lockstep time: the same bytes wherever nodes live, and clear words when a graph cannot go on."""

import random
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgpack
import pytest

from palp_core.errors import GraphError, NodeError
from palp_core.graph.lockstep.composition import Composition
from palp_core.graph.lockstep.conductor import Conductor, LockstepNodes
from palp_core.graph.messages.frame import parse
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.control_messages import Done, Round
from palp_core.graph.supervision.interrupt import ended_after

TOYS = '''
from palp_core import Alarm, Client, Message, Node, Params, Pub, Srv, State, Sub, every, on, serve

class Word(Message):
    n: float
    by: str = ""

class SourceParams(Params):
    hz: float = 3.0

class Source(Node):
    params: SourceParams
    out = Pub(Word)
    def on_activate(self):
        self.out.publish(Word(n=0.0, by=self.name))
    @every("hz")
    def tick(self):
        self.out.publish(Word(n=self.rng.random(), by=self.name))

class MixState(State):
    total: float = 0.0
    order: list[str] = []

class Mix(Node):
    """Sums two inputs, doubles the sum by a service, and publishes the order in which they came."""
    state: MixState
    a = Sub(Word)
    b = Sub(Word)
    double = Client(Word, Word)
    out = Pub(Word)
    @on(b)
    def take_b(self, word):
        self.state.order.append(word.by)
        self.double.call(Word(n=self.state.total + word.n))
    @on(a)
    def take_a(self, word):
        self.state.order.append(word.by)
        self.state.total += word.n
    @on(double)
    def learn(self, word):
        self.state.total = word.n % 1.0
        self.out.publish(Word(n=word.n, by=" ".join(self.state.order)))

class Doubler(Node):
    double = Srv(Word, Word)
    @serve(double)
    def answer(self, word):
        return Word(n=2.0 * word.n + 0.1 * self.rng.random())

class Sink(Node):
    state: MixState
    word = Sub(Word)
    @on(word)
    def take(self, word):
        self.state.total += 1
        if self.state.total == 20:
            self.finish(7)

class Echo(Node):
    word = Sub(Word)
    out = Pub(Word)
    @on(word)
    def take(self, word):
        self.out.publish(word)

class TwoEars(Node):
    a = Sub(Word)
    b = Sub(Word)
    out = Pub(Word)
    @on(a)
    def take_a(self, word):
        self.out.publish(word)
    @on(b)
    def take_b(self, word):
        self.out.publish(word)

class Restless(Node):
    bell = Alarm()
    def on_activate(self):
        self.bell.set(0)
    @on(bell)
    def ring(self):
        self.bell.set(self.now_ns())

class Fails(Node):
    word = Sub(Word)
    @on(word)
    def take(self, word):
        raise ValueError("no")

class Stubborn(Node):
    def on_deactivate(self):
        raise ValueError("stuck brake")

class Last(Node):
    out = Pub(Word)
    def on_deactivate(self):
        self.out.publish(Word(n=1.0, by=self.name))
'''


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(sys, "path", sys.path[:])
    (tmp_path / "toys.py").write_text(TOYS)
    return str(tmp_path)


def node(name: str, kind: str, **fields: object) -> NodeSpec:
    return NodeSpec(name=name, run=f"toys.py:{kind}", seed=11, **fields)  # type: ignore[arg-type]


GRAPH = [
    node("mix", "Mix", inputs={"a": "/fast/out", "b": "/slow/out", "double": "/twice/double"}),
    node("fast", "Source", params={"hz": 7.0}),
    node("sink", "Sink", inputs={"word": "/mix/out"}),
    node("slow", "Source"),
    node("twice", "Doubler", requests={"double": ["/mix/double"]}),
]


def readers_of(specs: Sequence[NodeSpec], nodes: Composition) -> dict[str, list[int]]:
    readers: dict[str, list[int]] = {}
    for index, node in enumerate(nodes._nodes):
        for topic in node.executor.ends.accounts:
            readers.setdefault(topic, []).append(index)
    return readers


class Split:
    """Nodes in several compositions, as if in several processes; replies come back in any order."""

    def __init__(self, specs: Sequence[NodeSpec], groups: Sequence[Sequence[int]], workspace: str) -> None:
        self.names = [spec.name for spec in specs]
        self._home = {}
        for group in groups:
            part = Composition([specs[index] for index in group], workspace)
            self._home.update({index: (part, local) for local, index in enumerate(group)})

    def activate(self, index: int) -> Done:
        part, local = self._home[index]
        return part.activate(local)

    def work(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        replies = {}
        for index in sorted(rounds, reverse=True):
            part, local = self._home[index]
            replies[index] = part.work({local: rounds[index]})[local]
        return replies

    def pending_commands(self) -> set[int]:
        return set()

    def shutdown(self, index: int, now_ns: int) -> Done:
        part, local = self._home[index]
        return part.shutdown(local, now_ns)


Seen = list[tuple[int, bytes]]


def conduct(
    specs: Sequence[NodeSpec], workspace: str, ends: Sequence[int] = (), nodes: LockstepNodes | None = None
) -> tuple[Conductor, Seen]:
    seen: Seen = []
    composed = Composition(specs, workspace)
    readers = readers_of(specs, composed)
    conductor = Conductor(
        nodes or composed, readers, ends, lambda now_ns, frame: seen.append((now_ns, frame))
    )
    return conductor, seen


def whole_run(workspace: str, nodes: LockstepNodes | None = None) -> Seen:
    conductor, seen = conduct(GRAPH, workspace, [2], nodes)
    conductor.activate()
    with ended_after(conductor.shutdown, range(len(GRAPH))):
        assert conductor.run() == 7
    return seen


def test_a_run_is_a_function_of_graph_and_seed(workspace: str) -> None:
    first = whole_run(workspace)
    assert first == whole_run(workspace)
    assert len({parse(frame).topic for _, frame in first}) >= 5


@pytest.mark.parametrize(
    "groups", [[[0], [1], [2], [3], [4]], [[4, 2, 0], [3, 1]], [[4, 3, 2, 1, 0]], [[1, 0], [2], [4, 3]]]
)
def test_the_frames_are_the_same_however_the_nodes_are_split(workspace: str, groups: list[list[int]]) -> None:
    assert whole_run(workspace, Split(GRAPH, groups, workspace)) == whole_run(workspace)


def test_without_what_nodes_consume_a_run_is_the_same(workspace: str) -> None:
    whole = whole_run(workspace)
    without = whole_run(workspace, Composition(GRAPH, workspace, keep_orders=False))
    assert without == [seen for seen in whole if not parse(seen[1]).topic.endswith("/_order")]
    assert len(without) < len(whole)


def test_messages_of_one_instant_come_by_topic_and_sequence_after_the_timers(workspace: str) -> None:
    conductor, seen = conduct(GRAPH, workspace)
    conductor.activate()
    conductor.run(10**9)
    mixed = [parse(frame) for _, frame in seen if parse(frame).topic == "/mix/out"]
    assert conductor.now_ns == 10**9
    received = msgpack.unpackb(mixed[-1].payload)["by"]
    # At 0 s and at 1 s both come, /fast before /slow; in between 7 Hz and 3 Hz interleave.
    assert received == "fast slow fast fast slow fast fast slow fast fast fast slow"


def test_time_leaps_to_the_next_due_timer_and_never_beyond_the_end(workspace: str) -> None:
    conductor, seen = conduct([node("slow", "Source", params={"hz": 0.001})], workspace)
    conductor.activate()
    assert conductor.run(999 * 10**9) == 0
    assert conductor.now_ns == 999 * 10**9
    assert conductor.run(1000 * 10**9) == 0
    assert [now_ns for now_ns, frame in seen if parse(frame).topic == "/slow/out"] == [0, 1000 * 10**9]
    assert conductor.activation_count == 1


def test_a_cycle_of_messages_is_named(workspace: str) -> None:
    specs = [
        node("ping", "Echo", inputs={"word": "/pong/out"}),
        node("pong", "TwoEars", inputs={"a": "/ping/out", "b": "/start/out"}),
        node("start", "Source"),
        node("bystander", "Echo", inputs={"word": "/start/out"}),
    ]
    conductor, _ = conduct(specs, workspace)
    with pytest.raises(GraphError, match="break the cycle") as caught:
        conductor.activate()
    words = str(caught.value)
    assert words.startswith("at 0.000 s the graph did not come to rest within 1000 rounds: p")
    assert "start" not in words
    assert "bystander" not in words


def test_an_alarm_that_always_rings_now_is_named(workspace: str) -> None:
    conductor, _ = conduct([node("restless", "Restless")], workspace)
    with pytest.raises(GraphError, match="1000 rounds: restless keep answering each other over alarms"):
        conductor.activate()


def test_a_graph_in_which_everyone_waits_is_stuck_and_says_so(workspace: str) -> None:
    conductor, _ = conduct([node("sink", "Sink", inputs={"word": "/nobody/out"})], workspace)
    conductor.activate()
    with pytest.raises(GraphError, match=r"at 0\.000 s the graph is stuck"):
        conductor.run()


def test_the_end_of_a_node_ends_the_run_only_if_the_graph_says_so(workspace: str) -> None:
    specs = [node("fast", "Source", params={"hz": 10.0}), node("sink", "Sink", inputs={"word": "/fast/out"})]
    conductor, _ = conduct(specs, workspace, ends=[1])
    conductor.activate()
    assert conductor.run() == 7
    assert conductor.now_ns == 1_900_000_000
    conductor, _ = conduct(specs, workspace)
    conductor.activate()
    assert conductor.run(5 * 10**9) == 0
    assert conductor.exit_code is None


def test_a_node_that_fails_ends_the_run_by_name(workspace: str) -> None:
    specs = [node("fast", "Source"), node("weak", "Fails", inputs={"word": "/fast/out"})]
    conductor, _ = conduct(specs, workspace)
    with pytest.raises(NodeError, match=r"weak: take \(handler of 'word'\) failed: ValueError: no"):
        conductor.activate()


def test_the_last_words_of_a_node_are_seen_at_the_time_of_the_end(workspace: str) -> None:
    specs = [node("last", "Last"), node("fast", "Source")]
    conductor, seen = conduct(specs, workspace)
    conductor.activate()
    with ended_after(conductor.shutdown, [0, 1]):
        conductor.run(10**9)
    frames = [(now_ns, parse(frame)) for now_ns, frame in seen]
    assert [(now_ns, f.stamp_ns) for now_ns, f in frames if f.topic == "/last/out"] == [(10**9, 10**9)]


def test_a_node_that_fails_at_its_end_keeps_no_other_from_its_safe_state(workspace: str) -> None:
    specs = [node("a", "Stubborn"), node("b", "Stubborn"), node("last", "Last")]
    conductor, seen = conduct(specs, workspace)
    conductor.activate()
    with (
        pytest.raises(NodeError, match="a: on_deactivate failed: ValueError: stuck brake"),
        ended_after(conductor.shutdown, [0, 1, 2]),
    ):
        pass
    assert "/last/out" in [parse(frame).topic for _, frame in seen]


def test_the_user_is_asked_once_per_instant_and_can_end_the_run(workspace: str) -> None:
    composed = Composition([node("fast", "Source", params={"hz": 10.0})], workspace)
    calls: list[int] = []

    def check() -> None:
        calls.append(conductor.now_ns)
        if len(calls) == 3:
            raise KeyboardInterrupt

    conductor = Conductor(composed, {}, [], lambda now_ns, frame: None, check)
    conductor.activate()
    with pytest.raises(KeyboardInterrupt):
        conductor.run()
    assert calls == [0, 100_000_000, 200_000_000]


def test_a_file_named_like_a_module_does_not_take_its_place(workspace: str) -> None:
    Path(workspace, "random.py").write_text(TOYS)
    Composition([NodeSpec(name="a", run="random.py:Source")], workspace)
    assert sys.modules["random"] is random


def test_a_class_that_is_not_there_is_named(workspace: str) -> None:
    for run, words in (("toys.py:Nobody", "no node class 'Nobody'"), ("gone.py:Source", "gone.py")):
        with pytest.raises(GraphError, match=words):
            Composition([NodeSpec(name="a", run=run)], workspace)
