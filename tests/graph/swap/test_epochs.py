"""Whatever happens to a node, its epochs never repeat: its readers hear every process that has its part."""

import os
import signal
from pathlib import Path
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from palp_core import Message, Node, Pub, Qos
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.supervision.managed_process import ManagedProcess
from palp_core.graph.transport.reorder_buffer import ReorderBuffer
from tests.support.palp import PATIENCE_S, Palp
from tests.support.stage import Stage
from tests.support.swapping import restarting_workspace

MANY = 50


class Life(Stage):
    """A graph whose middle node is killed and swapped."""

    def __init__(self, palp: Palp, folder: Path) -> None:
        super().__init__(palp, restarting_workspace(folder) / "wall.yaml")

    @property
    def account(self) -> dict[str, Any]:
        """What the reader knows of the node's messages."""
        found: dict[str, Any] = self.graph.ask("sink", "info", timeout_s=PATIENCE_S)["inputs"]["/relay/out"]
        return found

    def kill(self) -> None:
        """Let the node die, and wait until it is at work again."""
        process = self.pid("relay")
        os.kill(process, signal.SIGKILL)
        while not self.is_at_work(process):
            self.wait_for_source()

    def is_at_work(self, before: int = 0) -> bool:
        """Tell whether the node works, in another process than before."""
        process = self.pid("relay")
        if process in (0, before):
            return False
        info = self.graph.ask("relay", "info", timeout_s=PATIENCE_S)
        return bool(info["pid"] == process and info["lifecycle"] == "active")

    def hears(self, epoch: int) -> None:
        """Wait until the reader takes up messages of an epoch."""
        first = self.account["received"]
        while (account := self.account)["epoch"] != epoch or account["received"] < first + 20:
            assert account["repeated"] < MANY, f"the reader drops what it hears: {account}"
            self.wait_for_source()


def test_crash_swap_crash_strands_no_reader(palp: Palp, tmp_path: Path) -> None:
    life = Life(palp, tmp_path)
    life.kill()
    life.hears(1)
    assert "report" in life.swap("LooseOther")
    life.hears(1)
    life.kill()
    life.hears(2)
    assert life.graph.ask("relay", "info", timeout_s=PATIENCE_S)["run"] == "swap_toys:LooseOther"
    assert "report" in life.swap("Loose")
    life.hears(2)
    assert life.account["repeated"] == 0


def test_what_a_killed_node_could_not_send_any_more_is_counted_by_its_reader(
    palp: Palp, tmp_path: Path
) -> None:
    launch = restarting_workspace(tmp_path) / "wall.yaml"
    launch.write_text(launch.read_text().replace("swap_toys:Source", "swap_toys:LastWords"))
    stage = Stage(palp, launch)
    account: dict[str, Any] = {}
    while account.get("epoch") != 1:
        account = stage.graph.ask("relay", "info", timeout_s=PATIENCE_S)["inputs"]["/source/out"]
    assert account["received"] + account["dropped"] + account["lost"] == 20_000
    assert account["lost"] > 0
    while f"messages were lost ({account['lost']} in all)" not in stage.log("relay"):
        assert stage.launcher.poll() is None


def test_what_is_passed_on_for_a_successor_counts_as_published() -> None:
    made: list[bytes] = []
    old, new = (Executor(Speaker, SPEC, SimClock(), made.append) for _ in range(2))
    for executor in (old, new):
        executor.transition(Transition.CONFIGURE)
        executor.transition(Transition.ACTIVATE)
    noted: list[tuple[int, int]] = []
    old.ends.publishers["/p/word"].note = lambda *point: noted.append(point)
    new.node.word.publish(Word(n=1))  # type: ignore[attr-defined]
    old.ends.publishers["/p/word"].pass_on(next(raw for raw in made if parse(raw).topic == "/p/word"))
    assert noted == [(0, 1)]


# Any order of all that can happen, in memory: processes and wires are those of the graph, time is not


class Word(Message):
    n: int


class Speaker(Node):
    word = Pub(Word, qos=Qos(depth=5))


SPEC = NodeSpec(name="p", run="m:Speaker", restart="on_failure", max_restarts=10**6)


class EpochsInMemory(RuleBasedStateMachine):
    """A node, whoever has its part; a reader that hears all of it."""

    def __init__(self) -> None:
        super().__init__()
        self.account = SequenceAccount()
        deliver, ask = self.deliver, lambda *_: None
        self.reader = ReorderBuffer("/p/word", Qos(), self.account, deliver, ask)
        self.process = ManagedProcess(SPEC, Path(os.devnull))
        self.places = 0
        self.restarts = 0
        self.taken: list[int] = []
        self.spoken: list[int] = []
        self.executor = self.begun(SPEC)
        self.executor.transition(Transition.ACTIVATE)
        self.process.active = True

    def deliver(self, frame: Frame) -> None:
        if frame.kind != Kind.DATA:
            self.account.heartbeat(frame.epoch, frame.sequence)
        elif self.account.accept(frame.epoch, frame.sequence):
            self.taken.append(frame.stamp_ns)

    def begun(self, spec: NodeSpec, unheard: list[bytes] | None = None) -> Executor:
        """Start a process: it is heard, unless somebody else takes what it says."""
        made = Executor(Speaker, spec, SimClock(), self.hear if unheard is None else unheard.append)
        made.transition(Transition.CONFIGURE)
        return made

    def hear(self, raw: bytes) -> None:
        frame = parse(raw)
        if frame.topic == "/p/word":
            self.reader.arrive(frame, 0)

    def beside(self, unheard: list[bytes] | None) -> tuple[ManagedProcess, Executor]:
        self.places += 1
        spec = self.process.successor_spec(SPEC)
        return ManagedProcess(spec, Path(os.devnull), f"+{self.places}"), self.begun(spec, unheard)

    def handed_over(self) -> HandOver:
        return self.executor.full_snapshot()

    @initialize()
    def greet(self) -> None:
        for out in self.executor.ends.publishers.values():
            self.hear(out.heartbeat())

    @rule(count=st.integers(1, 20))
    def speak(self, count: int) -> None:
        for _ in range(count):
            number = len(self.spoken) + 1
            self.spoken.append(number)
            self.executor._now_ns = number
            self.executor.node.word.publish(Word(n=number))  # type: ignore[attr-defined]

    @rule()
    def swap(self) -> None:
        old = self.executor
        process, new = self.beside(None)
        new.take_over(old.hand_over())
        old.leave()
        process.active = True
        self.process, self.executor = process, new

    @rule(count=st.integers(0, 20))
    def shadow_or_fail(self, count: int) -> None:
        _, unheard = self.beside([])
        unheard.take_over(self.handed_over())
        for number in range(count):
            unheard.node.word.publish(Word(n=number))  # type: ignore[attr-defined]

    @rule()
    def kill(self) -> None:
        assert self.process.plan_restart(0, "killed")
        self.process.reset(0)
        self.process.active = True
        self.restarts += 1
        self.executor = self.begun(self.process.spec)
        self.executor.transition(Transition.ACTIVATE)

    @invariant()
    def everything_was_heard_once(self) -> None:
        assert self.taken == self.spoken
        assert (self.account.repeated, self.account.lost) == (0, 0)
        assert self.executor.epoch == self.process.spec.epoch == self.restarts


TestEpochsInMemory = EpochsInMemory.TestCase
TestEpochsInMemory.settings = settings(max_examples=40, stateful_step_count=30)
