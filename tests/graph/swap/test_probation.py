"""After a swap the old node stands by, and goes on from where the new one fails: nothing lost or repeated."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.swap.swap import STEPS
from tests.support.palp import Palp, end
from tests.support.stage import SLOW, Stage

LONG = {"run_count": 1_000_000, "longest_s": 240.0}
"""Longer than anything here lasts."""


def _swap(stage: Stage, run: str, probation: dict[str, Any] = LONG, **params: Any) -> dict[str, Any]:
    return stage.graph.swap("relay", f"swap_toys:{run}", timeout_s=240.0, params=params, probation=probation)


def _nothing_was_lost_or_repeated(stage: Stage) -> None:
    assert stage.judgement()[1] == ""
    for reader, name in (("sink", "/relay/out"), ("relay", "/source/out")):
        account = stage.graph.ask(reader, "info")["inputs"][name]
        assert (account["lost"], account["repeated"], account["dropped"]) == (0, 0, 0)


def test_the_old_node_goes_on_from_where_the_new_one_fails(stage: Stage) -> None:
    for deed, after in (("raise", 0), ("exit", 1), ("kill", 100), ("lie", 5), ("finish", 5)):
        failed = _swap(stage, "Novice", deed=deed, after=after)["failed"]
        assert failed["step"] == "probation", failed
        stage.passes(20)
    _nothing_was_lost_or_repeated(stage)
    makers = stage.judgement()[2]  # the work of one turn is taken back as a whole
    assert makers == ["Relay", "Novice"] * (len(makers) // 2) + ["Relay"]
    assert len(makers) >= 3
    assert len([event for event in stage.events() if event.kind == "swap_failed"]) == 5
    assert stage.graph.ask("relay", "info")["run"] == "swap_toys:Relay"
    assert "report" in stage.swap("Other")  # nothing is left of it that would keep a node from the next
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)


def test_a_node_that_does_well_has_the_part_by_itself(stage: Stage) -> None:
    report = _swap(stage, "Other", {"run_count": 3, "longest_s": 240.0})["report"]
    assert report["proven"] >= 3
    stage.passes(20)
    answer = _swap(stage, "Relay", {"run_count": 1_000_000, "longest_s": 0.2})
    assert answer.get("report", {}).get("proven", 0) > 0, answer
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)
    assert stage.judgement()[2] == ["Relay", "Other", "Relay"]
    swap = stage.graph.ask("relay", "info")["swaps"][-2]
    assert swap["gap_s"] == report["gap_s"] < report["duration_s"]


def test_a_successor_publishes_nothing_before_all_that_it_reported_is_published(stage: Stage) -> None:
    assert "report" in _swap(stage, "Laborious", {"run_count": 0, "longest_s": 0.0})
    assert _swap(stage, "Brief", {"run_count": 20, "longest_s": 240.0})["report"]["proven"] >= 20
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)


@pytest.mark.nightly
@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_a_large_state_loses_nothing_on_probation(palp: Palp, launch: Path, rate_hz: float) -> None:
    stage = Stage(palp, launch, "run:=swap_toys:Brief", f"rate_hz:={rate_hz}", "calls_hz:=10.0")
    assert "report" in _swap(stage, "Heavy", {"run_count": 3, "longest_s": 240.0})
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)


def test_a_state_that_nobody_can_take_back_is_proven_by_one_handler(own_stage: Stage) -> None:
    stage = own_stage
    failed = _swap(stage, "Loner", deed="raise", after=0)["failed"]
    assert failed["step"] == "probation"
    stage.passes(20)
    assert stage.judgement()[1:] == ("", ["Relay"])
    assert _swap(stage, "Loner", after=10**9)["report"]["proven"] >= 1
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)
    assert stage.judgement()[2] == ["Relay", "Loner"]


def test_a_class_is_tried_on_the_last_message_before_it_takes_over(stage: Stage) -> None:
    failed = stage.swap("Trainee", deed="raise", after=0)["failed"]
    assert failed["step"] == "state"
    assert "pass_on failed when it was tried on the last message of /source/out" in failed["text"]
    assert _swap(stage, "Trainee", deed="raise", after=2)["failed"]["step"] == "probation"
    assert stage.swap("Trainee", after=10**9)["report"]["proven"] >= 3
    assert _swap(stage, "Trainee", {"run_count": 0, "longest_s": 0.0}, after=10**9)["report"]["proven"] == -1
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)


def test_what_proves_a_class_is_what_it_says_and_not_any_handler(stage: Stage) -> None:
    failed = stage.swap("Seldom", deed="raise", after=60)["failed"]
    assert (failed["step"], "as asked" in failed["text"]) == ("probation", True)
    report = stage.swap("Seldom", after=10**9)["report"]
    assert report["proven"] >= 3  # by the time that the launcher hears of the third there may be more
    assert report["proven_by"] == "feat"
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)


def test_the_command_says_what_nothing_has_proven(stage: Stage) -> None:
    words = ("relay", "swap_toys:Idle", "after:=1000000000", "--probation", "0.2s", "--timeout", "100")
    done = stage.palp.run("swap", *words)
    assert "probation ended after no feat of the new node" in done.stderr
    assert "probation:" not in done.stdout
    _nothing_was_lost_or_repeated(stage)


def test_the_old_nodes_death_ends_the_probation_and_the_new_one_goes_on(stage: Stage) -> None:
    old = stage.pid("relay")
    assert "report" in _swap(stage, "Novice", deed="kill_other", pid=old, after=5)
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)
    assert stage.judgement()[2] == ["Relay", "Novice"]


def test_what_the_old_node_dies_before_publishing_is_published_by_the_new_one(own_stage: Stage) -> None:
    stage = own_stage
    assert "report" in _swap(stage, "Laborious", {"run_count": 0, "longest_s": 0.0})
    old = stage.pid("relay")
    assert "report" in _swap(stage, "Forgetful", deed="kill_other", pid=old, after=40)
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)


@pytest.mark.nightly
def test_a_handler_that_does_not_return_is_given_up(stage: Stage) -> None:
    failed = _swap(stage, "Novice", {"run_count": 10, "longest_s": 0.2}, deed="hang", after=5)["failed"]
    assert (failed["step"], failed["text"]) == ("probation", "a handler of it did not return within 5 s")
    stage.passes(20)
    assert stage.judgement()[1:] == ("", ["Relay", "Novice", "Relay"])


def test_the_command_tells_by_its_exit_status(stage: Stage) -> None:
    palp = stage.palp
    words = ("relay", "swap_toys:Novice", "deed:=raise", "after:=5", "--probation", "60s", "--timeout", "100")
    done = palp.run("swap", *words)
    assert done.returncode == 10 + STEPS.index("probation") == 18
    assert "/relay not swapped, the old node continues: probation: pass_on" in done.stderr
    printed = palp.printed("swap", "relay", "swap_toys:Other", "--probation", "2", "--timeout", "100")
    assert re.search(r"probation: [0-9]+ handlers ok", printed)
    for wrong in ("-1", "x", "3m", "nans"):
        refused = palp.refused("swap", "relay", "swap_toys:Relay", f"--probation={wrong}")
        assert "write a number of handlers" in refused
    stage.passes(20)
    _nothing_was_lost_or_repeated(stage)


@pytest.mark.nightly
def test_a_record_replays_through_a_probation_that_failed(palp: Palp, launch: Path, tmp_path: Path) -> None:
    stage = Stage(palp, launch, *SLOW, "--record", tmp_path / "bag")
    assert _swap(stage, "Novice", deed="raise", after=100)["failed"]["step"] == "probation"
    assert "report" in stage.swap("Relay", gain=3)
    stage.passes(20)
    end(stage.launcher)
    done = palp.printed(
        "bag", "replay", tmp_path / "bag", "--nodes", "relay", "--launch", launch, "--compare", "--json"
    )
    (relay,) = json.loads(done)
    assert (relay["divergence"], relay["uncovered"]) == (None, 0)
    assert relay["compared"] > 100
