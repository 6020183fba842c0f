"""Hot swap in simulated time: at an exact instant, the same bytes wherever the nodes live."""

from __future__ import annotations

import contextlib
import csv
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import NodeError
from palp_core.graph.launch.graph import Graph
from palp_core.graph.swap.swap import SwapFailed, SwapReport, SwapRequest
from tests.support.palp import Palp
from tests.support.swapping import workspace

SIM = Path(__file__).parents[2] / "launch/sim.yaml"


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = list(sys.path)
    yield workspace(tmp_path_factory.mktemp("swap")) / "sim.yaml"
    sys.path[:] = path  # a composed graph puts its workspace first


def _run(path: Path, swaps: list[tuple[float, str, str]], *, compose: bool, **args: Any) -> list[bytes]:
    frames: list[bytes] = []
    with Graph(path, compose=compose, observe=lambda _, frame: frames.append(frame), **args) as graph:
        for at_s, node, run in swaps:
            graph.plan_swap(at_s, node, run)
        assert graph.run().exit_code == 0
    return frames


def test_a_nodes_plan_swaps_at_an_exact_time_with_the_same_bytes_everywhere(launch: Path) -> None:
    first, second, composed = (_run(launch, [], compose=compose) for compose in (False, False, True))
    assert first == second == composed
    makers = [frame for frame in first if frame.startswith(b"/relay/out\0")]
    old = [index for index, frame in enumerate(makers) if b"\xa5Relay" in frame]
    assert old == list(range(len(old)))
    assert 0 < len(old) < len(makers)
    assert all(b"\xa5Other" in frame for frame in makers[len(old) :])


def test_a_planned_swap_that_fails_ends_the_run(launch: Path) -> None:
    for compose in (False, True):
        with Graph(launch, compose=compose) as graph:
            graph.plan_swap(0.1, "relay", "swap_toys:Plain")
            with pytest.raises(SwapFailed, match="cannot take the state") as failure:
                graph.run()
        assert failure.value.step == "state"


@pytest.mark.parametrize("params", ["{", "[1]", '{"gian": 1}'])
def test_a_plan_that_is_no_plan_ends_the_run_by_name(launch: Path, params: str) -> None:
    with Graph(launch, compose=True, params=params) as graph, pytest.raises(NodeError, match=r"planner|gian"):
        graph.run()


@pytest.mark.parametrize("compose", [False, True])
@pytest.mark.parametrize("step", ["configure", "state", "take over"])
def test_a_fault_changes_no_byte_of_the_run(launch: Path, step: str, *, compose: bool) -> None:
    params = {"step": step, "deed": "raise"}
    plain = _run(launch, [], compose=True, run="swap_toys:Relay")
    frames: list[bytes] = []
    with Graph(launch, compose=compose, observe=lambda _, frame: frames.append(frame)) as graph:
        graph.plan_swap(0.1, "relay", "swap_toys:Faulty", **params)
        swaps = graph.swaps
        turn = swaps.run_due

        def forgiving() -> None:
            with contextlib.suppress(SwapFailed):
                turn()

        swaps.run_due = forgiving  # type: ignore[method-assign]
        assert graph.run().exit_code == 0
    assert _without_orders(frames) == _without_orders(plain)


def _reported(graph: Graph) -> list[SwapReport]:
    """Collect what swaps come to."""
    reports: list[SwapReport] = []
    swap = graph.swaps.swap

    def kept(request: SwapRequest) -> SwapReport:
        reports.append(swap(request))
        return reports[-1]

    graph.swaps.swap = kept  # type: ignore[method-assign]
    return reports


def _without_orders(frames: list[bytes]) -> list[bytes]:
    """Leave out the record of what was consumed: its batches end where a node was asked to hand in."""
    return [frame for frame in frames if b"/_order\0" not in frame]


def test_a_shadow_in_simulated_time_runs_beside_and_changes_nothing(launch: Path) -> None:
    found = []
    for compose in (False, True):
        with Graph(launch, compose=compose, run="swap_toys:Relay") as graph:
            request = SwapRequest(node="relay", run="swap_toys:Other", shadow_s=0.1, dry_run=True)
            graph.swaps.plan(50_000_000, request)
            reports = _reported(graph)
            assert graph.run().exit_code == 0
        found.append(reports[0])
    assert found[0] == found[1]
    assert found[0].shadow["compared"] == found[0].shadow["differing"] == 120  # numbers and replies
    assert (found[0].shadow["only_old"], found[0].shadow["only_new"]) == (0, 0)
    assert found[0].at_s == pytest.approx(0.15)


def test_a_policy_that_asks_for_what_was_not_trained_costs_its_trials_and_not_the_session(
    palp: Palp, tmp_path: Path
) -> None:
    odd = tmp_path / "odd.py"
    odd.write_text(
        "from nodes.policy import PolicyNode\n"
        "from palp_core.palpation.perception.strategy.policies import FixedRing\n"
        "class Odd(PolicyNode):\n"
        "    def choose(self):\n"
        "        return FixedRing(float('nan'))\n"
    )
    swaps = f"2={odd}:Odd,3=nodes.policy_fixed:Fixed"
    small = ("trials:=2", "training:=3", "seed:=4", "policy:=fixed", f"out:={tmp_path / 'out'}")
    done = palp.run("launch", SIM, "--compose", f"swaps:={swaps}", *small)
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    reason = "ring position 49 mm was not trained"
    assert [one["reason"] for one in result["trials_dropped"]] == [reason, reason]
    assert (result["trials_done"], result["trials_unfinished"]) == (4, 0)
    assert reason in (tmp_path / "out" / "report.html").read_text()
    again = palp.run("analyse", tmp_path / "out", "--out", tmp_path / "again")
    assert again.returncode == 0, again.stderr
    (row,) = json.loads((tmp_path / "again" / "analysis.json").read_text())["results"]
    assert (row["trials"], row["left_out"]) == (4, 2)


@pytest.mark.parametrize("how", [["--compose"], pytest.param([], marks=pytest.mark.slow)])
def test_the_rigs_policies_take_over_in_the_middle_of_a_trial(
    palp: Palp, tmp_path: Path, how: list[str]
) -> None:
    swaps = "2=nodes.policy_uniform:Uniform,4=nodes.policy_markov:Markov"
    small = ("trials:=2", "training:=3", "seed:=4", "policy:=fixed", "stop:=fixed_number", f"out:={tmp_path}")
    done = palp.run("launch", SIM, *how, f"swaps:={swaps}", *small)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "trials.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["phase"] == "estimation"]
    trials = list(dict.fromkeys(row["trial"] for row in rows))
    policies = [[row["policy"] for row in rows if row["trial"] == trial] for trial in trials]
    assert policies[0] == ["fixed"] * len(policies[0])
    assert policies[1][0] == "fixed"
    assert policies[1][1:] == ["uniform"] * (len(policies[1]) - 1) != []
    assert policies[3][0] == "uniform"
    assert set(policies[3][1:]) == {"markov"}
    assert [row["iteration"] for row in rows if row["trial"] == trials[1]][:2] == ["1", "2"]
