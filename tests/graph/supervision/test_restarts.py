"""Who is silent is noticed, who fails is restarted by rule, who cannot be is named."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from palp_core.errors import NodeError
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import encode
from palp_core.graph.node.spec import LONGEST_BACKOFF_S, NodeSpec
from palp_core.graph.supervision import restarts
from palp_core.graph.supervision.interrupt import KILL_NS
from palp_core.graph.supervision.liveness import GIVE_UP_NS, HANG_NS, Liveness
from palp_core.graph.supervision.managed_process import STABLE_NS, ManagedProcess
from palp_core.graph.supervision.restarts import READY_NS, Restarts
from tests.support.fake_graph import health_of

S = 1_000_000_000


def look_each_second(liveness: Liveness[int], until_ns: int, start_ns: int = 0) -> list[tuple[int, int]]:
    found = []
    for now_ns in range(start_ns, until_ns + 1, S // 2):
        found += list(liveness.unresponsive(now_ns))
    return found


class Stage:
    """Processes, what is done to them and said of them; its time is its own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, *specs: NodeSpec) -> None:
        self.now_ns = S
        monkeypatch.setattr(restarts, "monotonic_ns", lambda: self.now_ns)
        self.processes = [ManagedProcess(spec, folder / f"{spec.name}.log") for spec in specs]
        self.done: list[tuple[Any, ...]] = []
        self.said: list[tuple[str, str]] = []
        self.texts: list[str] = []
        self.healths: list[list[NodeHealth]] = []
        self.restarts = Restarts(
            self.processes, cast("Any", self), self.activate, cast("Any", self), restarts=True
        )

    def spawn(self, process: ManagedProcess) -> None:
        self.done.append(("spawn", process.spec.name))

    def activate(self, index: int) -> None:
        self.done.append(("activate", self.processes[index].spec.name))

    def signal(self, process: ManagedProcess, *numbers: signal.Signals) -> None:
        self.done += [(number.name, process.spec.name) for number in numbers]

    def report(self, kind: str, node: str, text: str, /, **data: Any) -> None:
        self.said.append((kind, node))
        self.texts.append(text)

    def publish_health(self, nodes: list[NodeHealth]) -> None:
        self.healths.append(nodes)

    def ready(self) -> None:
        """All are at work and have been heard."""
        for index, process in enumerate(self.processes):
            process.configured = process.matched = True
            self.restarts.on_health(index, encode(health_of(process.spec.name)))
        self.turn(self.now_ns)
        self.done.clear()

    def turn(self, until_ns: int) -> None:
        """Turn twice a second until then."""
        while self.now_ns <= until_ns:
            self.restarts.run_due(self.now_ns)
            self.now_ns += S // 2

    def end(self, index: int) -> None:
        self.processes[index].ended = True
        self.restarts.forget(index)


def restarted(name: str, **fields: Any) -> NodeSpec:
    return NodeSpec(name=name, run="m:A", restart="on_failure", **fields)


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stage:
    made = Stage(tmp_path, monkeypatch, restarted("a", max_restarts=2), NodeSpec(name="b", run="m:B"))
    made.ready()
    return made


def test_silence_begins_when_a_node_was_last_heard() -> None:
    liveness = Liveness[int]()
    liveness.expect(0, 0)
    liveness.record(0, health_of(), 0)
    assert look_each_second(liveness, HANG_NS - 1) == []
    liveness.record(0, health_of(), 2 * S)
    assert look_each_second(liveness, 2 * S + HANG_NS, HANG_NS) == [(0, HANG_NS)]


def test_nobody_is_blamed_for_time_in_which_the_supervisor_itself_stood_still() -> None:
    liveness = Liveness[int]()
    liveness.expect(0, 0)
    liveness.record(0, health_of(), 0)
    look_each_second(liveness, S)
    assert list(liveness.unresponsive(100 * S)) == []
    assert look_each_second(liveness, 101 * S, 100 * S) == []
    assert look_each_second(liveness, 103 * S, 101 * S + S // 2)[-1] == (0, 4 * S)


def test_a_node_that_has_never_been_heard_or_has_ended_is_not_missed() -> None:
    liveness = Liveness[int]()
    liveness.expect(0, 0)
    liveness.expect(1, 0)
    liveness.record(1, health_of(), 0)
    liveness.forget(1)
    assert look_each_second(liveness, 20 * S) == []
    assert liveness.health == []


def test_an_unresponsive_node_is_said_once_and_so_is_its_return(stage: Stage) -> None:
    stage.turn(2 * HANG_NS)
    assert stage.said == [("unresponsive", "a"), ("unresponsive", "b")]
    stage.restarts.on_health(1, encode(health_of("b")))
    stage.restarts.on_health(1, encode(health_of("b")))
    assert stage.said[2:] == [("responsive", "b")]
    assert stage.done == []


def test_the_last_log_lines_of_an_unresponsive_node_are_in_the_warning(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    stage.processes[0].log.write_text("opening the device\n")
    stage.turn(2 * HANG_NS)
    assert "opening the device" in caplog.text


def test_only_a_node_whose_rule_says_so_is_restarted_for_its_silence(stage: Stage) -> None:
    stage.turn(2 * GIVE_UP_NS)
    assert ("restarting", "a") in stage.said
    assert ("restarting", "b") not in stage.said
    assert stage.done[:2] == [("SIGTERM", "a"), ("SIGCONT", "a")]


def test_one_that_does_not_go_meets_the_signal_that_cannot_be_refused(stage: Stage) -> None:
    stage.turn(S + GIVE_UP_NS)
    planned_ns = stage.processes[0].respawn_at_ns
    assert planned_ns is not None
    stage.turn(planned_ns + KILL_NS)
    assert ("SIGKILL", "a") not in stage.done
    stage.turn(planned_ns + KILL_NS + S)
    assert ("SIGKILL", "a") in stage.done
    assert ("spawn", "a") not in stage.done
    stage.end(0)
    stage.turn(stage.now_ns)
    assert stage.done[-1] == ("spawn", "a")


def test_a_restarted_node_is_activated_when_it_is_matched(stage: Stage) -> None:
    stage.end(0)
    assert stage.restarts.restart(0, "its process was killed by SIGKILL")
    stage.turn(stage.now_ns + S)
    stage.processes[0].configured = True
    stage.turn(stage.now_ns)
    assert stage.done == [("spawn", "a")]
    stage.processes[0].matched = True
    stage.turn(stage.now_ns)
    assert stage.done[-1] == ("activate", "a")
    assert stage.said == [("restarting", "a"), ("restarted", "a")]


def test_a_restart_that_never_gets_ready_is_given_up_by_rule(stage: Stage) -> None:
    stage.end(0)
    stage.restarts.restart(0, "fell")
    stage.turn(stage.now_ns + READY_NS + 2 * S)
    assert stage.said.count(("restarting", "a")) == 2
    stage.end(0)
    with pytest.raises(NodeError, match="a: was not configured within 60 s"):
        stage.turn(stage.now_ns + 2 * READY_NS)


def test_the_limit_of_restarts_holds_until_a_node_has_worked_well_for_a_while(tmp_path: Path) -> None:
    process = ManagedProcess(restarted("a", max_restarts=1), tmp_path / "a.log")
    process.activate(0)
    assert process.plan_restart(S, "fell").startswith("fell; restart 1 of 1")
    process.reset(2 * S)
    process.activate(2 * S)
    assert process.plan_restart(3 * S, "fell") == ""
    assert process.plan_restart(2 * S + STABLE_NS, "fell") != ""
    assert process.spec.epoch == 2  # what readers count never goes back


@pytest.mark.parametrize(
    ("restart_count", "wait_s"), [(0, 0.5), (1, 1.0), (2, 2.0), (100_000, LONGEST_BACKOFF_S)]
)
def test_the_back_off_doubles_up_to_an_hour(tmp_path: Path, restart_count: int, wait_s: float) -> None:
    process = ManagedProcess(restarted("a", max_restarts=1_000_000, backoff_s=0.5), tmp_path / "a.log")
    process.activate(0)
    process.restart_count = restart_count
    process.plan_restart(S, "fell")
    assert process.respawn_at_ns == S + wait_s * S
    assert process.restart_count == restart_count + 1


def test_a_node_that_was_never_at_work_is_not_restarted(tmp_path: Path) -> None:
    assert ManagedProcess(restarted("a"), tmp_path / "a.log").plan_restart(0, "fell") == ""


def test_a_node_that_is_restarted_or_silent_says_so_to_a_swap_that_needs_it(stage: Stage) -> None:
    process = stage.processes[0]
    assert process.absence() == ""
    stage.turn(2 * HANG_NS)
    assert process.absence().startswith("has sent no heartbeat for seconds")
    stage.restarts.restart(0, "fell")
    assert process.absence() == "is being restarted; ask again when it is active"


def test_health_is_published_once_a_second(stage: Stage) -> None:
    stage.healths.clear()
    stage.turn(stage.now_ns + 10 * S)
    assert len(stage.healths) in (10, 11)
    assert [node.node for node in stage.healths[0]] == ["a", "b"]


def test_turns_in_which_nothing_is_due_ask_no_process_whatever_their_number(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.restarts.run_due(stage.now_ns)
    looks: list[int] = []

    def look(_: Liveness[int], now_ns: int) -> Iterator[tuple[int, int]]:
        looks.append(now_ns)
        yield from ()

    monkeypatch.setattr(Liveness, "unresponsive", look)
    step_ns = restarts.LOOK_NS // 50
    for turn in range(1, 101):
        stage.restarts.run_due(stage.now_ns + turn * step_ns)
    assert len(looks) == 2
    assert stage.restarts.idle_s(stage.now_ns + 100 * step_ns) == pytest.approx(restarts.LOOK_NS / 1e9)
    stage.restarts.look_soon()
    stage.restarts.run_due(stage.now_ns + 100 * step_ns)
    assert len(looks) == 3
