"""A policy that takes over by hand while a session runs stands in its results as one that was planned."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from palp_core.graph.swap.swap import SwapRequest
from palp_core.palpation.session.bag_record import write_record
from palp_core.palpation.session.many.overview import find_sessions
from palp_core.palpation.session.policy_changes import unplanned_spans
from palp_core.palpation.session.report import write
from palp_core.palpation.session.trials_csv import read_rows
from tests.support.palp import SIM
from tests.support.rig_session import ComposedGraph
from tests.support.sessions import no_charts

SMALL = (
    "trials:=2",
    "training:=1",
    "seed:=4",
    "policy:=markov",
    "shared.stop:=fixed_number",
    "shared.stop_value:=4",
)


def run(out: Path, *, bag: Path | None = None) -> None:
    """Run a session into which a policy comes in training, and another after two palpations of trial 2."""
    from msgs.estimation import Belief

    felt: list[int] = []
    beliefs: list[tuple[int, int]] = []

    def take(now_ns: int, frame: bytes) -> None:
        if frame.startswith(b"/estimator/palpation\0"):
            felt.append(now_ns)
            if len(felt) == 4:
                fixed = SwapRequest(node="policy", run="nodes.policy_fixed:Fixed", params={"ring_mm": 12.0})
                graph.swaps.plan(now_ns, fixed)
        if frame.startswith(b"/estimator/belief\0"):
            belief = decode(Belief, parse(frame).payload)
            beliefs.append((belief.trial, belief.iteration))
            if belief.iteration == 2 and len({trial for trial, _ in beliefs}) == 2:
                graph.swaps.plan(now_ns + 1, SwapRequest(node="policy", run="nodes.policy_uniform:Uniform"))

    swaps = "swaps:=4=nodes.policy_markov:Markov"
    with ComposedGraph(SIM, overrides=[*SMALL, swaps, f"out:={out}"], record=bag, observe=take) as graph:
        assert graph.run().exit_code == 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("by_hand")
    run(folder / "out", bag=folder / "bag")
    return folder


def test_each_row_names_who_chose_it(folder: Path) -> None:
    rows = [row for row in read_rows(folder / "out") if row.phase == "estimation"]
    spans = [next(group) for _, group in itertools.groupby(rows, key=lambda row: row.policy)]
    found = [(row.policy, row.trial, row.iteration) for row in spans]
    assert found == [("fixed", 1, 1), ("uniform", 2, 4), ("markov", 4, 2)]  # of trial 2 the third was chosen


def test_result_page_and_overview_name_all_who_decided_and_the_page_what_no_command_gives(
    folder: Path,
) -> None:
    result = json.loads((folder / "out" / "result.json").read_text())
    chose = [(one["policy"], one["trial"], one["palpation"]) for one in result["policies"]]
    assert chose == [("fixed", 1, 1), ("uniform", 2, 4), ("markov", 4, 2)]
    page = " ".join((folder / "out" / "report.html").read_text().split())
    assert "from trial 2 on uniform, from trial 4 on markov" in page.partition("</h1>")[0]
    assert "from trial 2 on uniform, from trial 4 on markov” found the right depth" in page
    at_s = result["policies"][1]["at_s"]
    assert f"<td>uniform</td><td>2</td><td>4</td><td>{at_s:,.1f} s</td>" in page
    assert "nothing else that was changed of nodes while the session ran" in page
    (entry,) = find_sessions(folder / "out")
    assert ", by hand fixed from trial 1, palpation 1, by hand uniform from trial 2" in entry.design
    assert "by hand markov" not in entry.design


@pytest.mark.parametrize(
    ("chose", "by_hand"),
    [
        ("mm mm mu uu", ""),  # as planned: uniform from trial 3 on
        ("mm mm m uu", ""),
        ("mm mu uu uu", "u2.2"),  # the planned one, in another trial: it was there already when it was due
        ("mm mm mu mm", "m4.1"),  # back to the first
        ("mm mm mm mm", "m3.2"),  # the planned one never came
        ("ff mm mu uu", "f1.1 m2.1"),
    ],
)
def test_another_choice_than_planned_is_by_hand(chose: str, by_hand: str) -> None:
    names = {"m": "markov", "u": "uniform", "f": "fixed"}
    facts = [
        {"policy": names[one], "trial": trial, "iteration": iteration}
        for trial, policies in enumerate(chose.split(), 1)
        for iteration, one in enumerate(policies, 1)
    ]
    rows: list[Any] = [
        SimpleNamespace(phase="estimation", row=row, start_ns=0, **more) for row, more in enumerate(facts)
    ]
    found = unplanned_spans(rows, "nodes.policy_markov:Markov", "3=nodes.policy_uniform:Uniform")
    assert " ".join(f"{one.policy[0]}{one.trial}.{one.palpation}" for one in found) == by_hand


def test_the_bag_gives_the_same_rows_and_changes(folder: Path) -> None:
    with no_charts():
        write(folder / "again", write_record(folder / "bag", folder / "again"))
    ours, theirs = (folder / name for name in ("again", "out"))
    assert (ours / "trials.csv").read_bytes() == (theirs / "trials.csv").read_bytes()
    changes = [json.loads((one / "result.json").read_text())["changes"] for one in (ours, theirs)]
    assert changes[0] == changes[1]


def test_a_swap_in_training_is_listed_with_its_time_and_who_gave_way_has_estimated_nothing(
    folder: Path,
) -> None:
    change, *_ = json.loads((folder / "out" / "result.json").read_text())["changes"]
    assert (change["phase"], change["palpation"], change["params"]) == ("training", 5, {"ring_mm": 12.0})
    assert (change["before"], change["run"]) == ("nodes.policy_markov:Markov", "nodes.policy_fixed:Fixed")
    page = " ".join((folder / "out" / "report.html").read_text().split())
    assert "policy: fixed, from trial 2 on uniform, from trial 4 on markov</h1>" in page
    assert "The policy “fixed, from trial 2 on uniform, from trial 4 on markov” found" in page
    assert f"<td>{change['at_s']:,.1f} s</td><td>5, of training</td><td>/policy</td>" in page
