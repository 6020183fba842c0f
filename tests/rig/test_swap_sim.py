"""Hot swap in simulated time: at an exact instant, the same bytes wherever the nodes live."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.errors import NodeError
from palp_core.graph.launch.graph import Graph
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from palp_core.graph.swap.swap import Probation, SwapFailed, SwapReport, SwapRequest
from tests.support.palp import Palp
from tests.support.rig_session import ComposedGraph
from tests.support.sessions import blank_charts
from tests.support.swapping import workspace

__all__ = ["blank_charts"]

SIM = Path(__file__).parents[2] / "launch/sim.yaml"
HOW = pytest.mark.parametrize("compose", [True, pytest.param(False, marks=pytest.mark.nightly)])
"""That processes say the same bytes, swap and all, is held once by default."""


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return workspace(tmp_path_factory.mktemp("swap")) / "sim.yaml"


def graph_of(path: Path, *, compose: bool, **given: Any) -> Graph:
    return ComposedGraph(path, **given) if compose else Graph(path, **given)


def _run(path: Path, swaps: list[tuple[float, str, str]], *, compose: bool, **args: Any) -> list[bytes]:
    frames: list[bytes] = []
    with graph_of(path, compose=compose, observe=lambda _, frame: frames.append(frame), **args) as graph:
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


@pytest.fixture(scope="module")
def plain(launch: Path) -> list[bytes]:
    """What is published where nothing but the plan's own swap is done."""
    return _run(launch, [], compose=True, run="swap_toys:Relay")


@HOW
def test_a_planned_swap_that_fails_ends_the_run(launch: Path, *, compose: bool) -> None:
    with graph_of(launch, compose=compose) as graph:
        graph.plan_swap(0.1, "relay", "swap_toys:Plain")
        with pytest.raises(SwapFailed, match="cannot take the state") as failure:
            graph.run()
    assert failure.value.step == "state"


@pytest.mark.parametrize("params", ["{", "[1]", '{"gian": 1}'])
def test_a_plan_that_is_no_plan_ends_the_run_by_name(launch: Path, params: str) -> None:
    with ComposedGraph(launch, params=params) as graph, pytest.raises(NodeError, match=r"planner|gian"):
        graph.run()


@HOW
@pytest.mark.parametrize("step", ["configure", "state", "take over"])
def test_a_fault_changes_no_byte_of_the_run(
    launch: Path, plain: list[bytes], step: str, *, compose: bool
) -> None:
    params = {"step": step, "deed": "raise"}
    frames: list[bytes] = []
    with graph_of(launch, compose=compose, observe=lambda _, frame: frames.append(frame)) as graph:
        graph.plan_swap(0.1, "relay", "swap_toys:Faulty", **params)
        _forgiving(graph)
        assert graph.run().exit_code == 0
    assert _without_orders(frames) == _without_orders(plain)
    assert _consumed(frames) == _consumed(plain)


def _consumed(frames: list[bytes]) -> dict[str, list[tuple[object, ...]]]:
    """What each node has written down of what it consumed, whatever its batches are."""
    found: dict[str, list[tuple[object, ...]]] = {}
    for frame in map(parse, (raw for raw in frames if b"/_order\0" in raw)):
        order = decode(Order, frame.payload)
        entries = zip(order.source, order.epoch, order.sequence, order.now_ns, strict=True)
        found.setdefault(frame.topic, []).extend((order.sources[at], *entry) for at, *entry in entries)
    return found


def _observer(frames: list[bytes]) -> Callable[[int, bytes], None]:
    return lambda _, frame: frames.append(frame)


def _forgiving(graph: Graph) -> list[SwapFailed]:
    """Let the run go on after a swap that failed; collect what failed."""
    failures: list[SwapFailed] = []
    turn = graph.swaps.run_due

    def forgiving() -> None:
        try:
            turn()
        except SwapFailed as failure:
            failures.append(failure)

    graph.swaps.run_due = forgiving  # type: ignore[method-assign]
    return failures


PROBATIONS: list[tuple[str, str, int, list[str]]] = [
    ("Novice", "raise", 3, ["Relay", "Novice", "Relay"]),
    ("Novice", "raise", 0, ["Relay"]),
    ("Novice", "lie", 3, ["Relay", "Novice", "Relay"]),
    ("Novice", "finish", 3, ["Relay", "Novice", "Relay"]),
    ("Novice", "lose", 3, ["Relay", "Novice", "Relay"]),
    ("Boaster", "boast", 0, ["Relay"]),
    ("Loner", "raise", 0, ["Relay"]),
    ("Novice", "", 0, ["Relay", "Novice"]),
]


@pytest.mark.parametrize(
    ("run", "deed", "after", "makers", "ways"),
    [
        *(pytest.param(*one, (True,)) for one in PROBATIONS),
        *(pytest.param(*one, (False, True), marks=pytest.mark.nightly) for one in PROBATIONS),
        pytest.param("Novice", "kill", 3, ["Relay", "Novice", "Relay"], (False,), id="kill"),
    ],
)
def test_on_probation_the_old_node_goes_on_from_the_last_round_that_went_well(
    launch: Path,
    plain: list[bytes],
    run: str,
    deed: str,
    after: int,
    makers: list[str],
    ways: tuple[bool, ...],
) -> None:
    found = []
    for compose in ways:
        frames: list[bytes] = []
        seen = _observer(frames)
        with graph_of(launch, compose=compose, run="swap_toys:Relay", observe=seen) as graph:
            params = {"deed": deed, "after": after}
            probation = Probation(100, 0.05)
            request = SwapRequest(node="relay", run=f"swap_toys:{run}", params=params, probation=probation)
            graph.swaps.plan(50_000_000, request)
            failures, reports = _forgiving(graph), _reported(graph)
            assert graph.run().exit_code == 0
        assert [failure.step for failure in failures] == ["probation"] * bool(deed)
        assert all(report.proven >= 40 for report in reports if report.after != "swap_toys:Other")
        found.append(frames)
    assert all(other == found[0] for other in found)
    numbers = [parse(frame) for frame in found[0] if frame.startswith(b"/relay/out\0")]
    values = [msgspec.msgpack.decode(number.payload) for number in numbers]
    assert [value["index"] for value in values] == list(range(1, len(values) + 1))
    assert [number.sequence for number in numbers] == list(range(1, len(values) + 1))
    by = [maker for maker, _ in itertools.groupby(value["by"] for value in values)]
    assert by == [*makers, "Other"]  # the plan's own swap comes later
    if makers == ["Relay"]:
        assert _without_orders(found[0]) == _without_orders(plain)


@HOW
def test_what_neither_node_can_do_ends_the_run(launch: Path, *, compose: bool) -> None:
    params = {"after": 25}
    with graph_of(launch, compose=compose, run="swap_toys:Relay") as graph:
        graph.plan_swap(0.005, "relay", "swap_toys:Brittle", **params)
        request = SwapRequest(
            node="relay", run="swap_toys:Brittle", params=params, probation=Probation(99, 1.0)
        )
        graph.swaps.plan(10_000_000, request)
        with pytest.raises(NodeError, match="too much"):
            graph.run()


@HOW
def test_a_plan_that_is_due_on_probation_is_kept_and_a_state_beyond_words_is_taken_back(
    launch: Path, *, compose: bool
) -> None:
    with graph_of(launch, compose=compose, run="swap_toys:Relay") as graph:
        failing = SwapRequest(
            node="relay", run="swap_toys:Vague", params={"after": 5}, probation=Probation(99, 0.05)
        )
        graph.swaps.plan(10_000_000, failing)
        good = SwapRequest(node="relay", run="swap_toys:Other", probation=Probation(10_000, 0.05))
        graph.swaps.plan(50_000_000, good)
        graph.plan_swap(0.06, "relay", "swap_toys:Loose")
        failures, reports = _forgiving(graph), _reported(graph)
        assert graph.run().exit_code == 0
    assert [(failure.step, "cannot be written down" in failure.text) for failure in failures] == [
        ("probation", True)
    ]
    swaps = [(report.after, report.at_s) for report in reports]
    assert swaps[:2] == [("swap_toys:Other", 0.05), ("swap_toys:Loose", pytest.approx(0.1, abs=0.002))]


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


@HOW
def test_a_shadow_in_simulated_time_runs_along_and_changes_nothing(launch: Path, *, compose: bool) -> None:
    with graph_of(launch, compose=compose, run="swap_toys:Relay") as graph:
        request = SwapRequest(node="relay", run="swap_toys:Other", shadow_s=0.1, dry_run=True)
        graph.swaps.plan(50_000_000, request)
        reports = _reported(graph)
        assert graph.run().exit_code == 0
    (found, *_) = reports
    assert found.shadow["compared"] == found.shadow["differing"] == 120  # numbers and replies
    assert (found.shadow["only_old"], found.shadow["only_new"]) == (0, 0)
    assert found.at_s == pytest.approx(0.15)


@pytest.mark.usefixtures("blank_charts")
def test_a_policy_that_asks_for_what_was_not_trained_costs_its_trials_and_not_the_session(
    palp: Palp, tmp_path: Path
) -> None:
    odd = tmp_path / "odd.py"
    odd.write_text(
        "from nodes.policy import PolicyNode\n"
        "from palp_core.palpation.perception.strategy.policies import FixedRing\n"
        "class Odd(PolicyNode):\n"
        "    def choose(self):\n"
        "        return FixedRing(0.016)\n"
        "    def policy_for_next_probe(self):\n"
        "        return FixedRing(float('nan') if self.state.iteration > 3 else 0.016)\n"
    )
    out = tmp_path / "out"
    small = (
        "trials:=2",
        "training:=1",
        "seed:=4",
        "policy:=fixed",
        "shared.stop:=fixed_number",
        f"out:={out}",
    )
    with ComposedGraph(SIM, overrides=[*small, f"swaps:=1={odd}:Odd,3=nodes.policy_fixed:Fixed"]) as graph:
        assert graph.run().exit_code == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    reason = "ring position 49 mm was not trained"
    assert [one["reason"] for one in result["trials_dropped"]] == [reason, reason]
    assert (result["trials_done"], result["trials_unfinished"]) == (4, 0)
    assert reason in (tmp_path / "out" / "report.html").read_text()
    again = palp.here("session", "reanalyse", tmp_path / "out", "--out", tmp_path / "again")
    assert again.returncode == 0, again.stderr
    (row,) = json.loads((tmp_path / "again" / "analysis.json").read_text())["results"]
    assert (row["trials"], row["left_out"]) == (4, 2)


BAD_POLICIES = """
import dataclasses

from nodes.policy_fixed import Fixed
from palp_core.palpation.perception.strategy.policies import FixedRing


class Silent(Fixed):
    def choose(self):
        return None


class Late(Fixed):
    def policy_for_next_probe(self):
        self.asked = getattr(self, "asked", 0) + 1
        if self.asked > 2:  # once it is tried, then late: many seconds after it took over
            raise IndexError("late")
        return self.policy


class Untrained(Fixed):
    def policy_for_next_probe(self):
        return FixedRing(0.017)


class Tired(Fixed):
    def policy_for_next_probe(self):
        self.asked = getattr(self, "asked", 0) + 1
        if self.asked > 2:  # once it is tried, once it does well
            raise RuntimeError("tired")
        return self.policy


@dataclasses.dataclass(frozen=True)
class Lost(FixedRing):
    def start(self, uniform, trial_count=None):
        raise LookupError("does not know where to begin")


class Astray(Fixed):
    def choose(self):
        return Lost(0.016)
"""


def test_a_bad_policy_costs_the_session_nothing(tmp_path: Path) -> None:
    """Nor does one that comes in training: it has proven nothing before it has chosen."""
    bad = tmp_path / "bad.py"
    bad.write_text(BAD_POLICIES)
    felt: list[int] = []
    beliefs: list[int] = []

    def plan(now_ns: int, name: str, probation: Probation) -> None:
        request = SwapRequest(node="policy", run=f"{bad}:{name}", probation=probation, timeout_s=600.0)
        graph.swaps.plan(now_ns, request)

    def take(now_ns: int, frame: bytes) -> None:
        if frame.startswith(b"/estimator/palpation\0"):
            felt.append(now_ns)
            if len(felt) == 2:
                plan(now_ns, "Astray", Probation())
        if frame.startswith(b"/estimator/belief\0"):
            beliefs.append(now_ns)
            name = {2: "Silent", 3: "Tired", 6: "Late", 9: "Untrained"}.get(len(beliefs))
            if name:  # policies have the other probation by default
                plan(now_ns, name, Probation(10, 60.0) if name == "Tired" else Probation())

    small = ("trials:=1", "training:=2", "seed:=4", "policy:=fixed", "shared.stop:=fixed_number")
    with ComposedGraph(SIM, overrides=[*small, f"out:={tmp_path / 'out'}"], observe=take) as graph:
        failures = _forgiving(graph)
        assert graph.run().exit_code == 0
    assert len(felt) > 30  # training, and then the trials of the old one
    assert [(failure.step, failure.text.split(":")[-1]) for failure in failures[:4]] == [
        ("probation", " does not know where to begin"),
        ("state", " 'NoneType' object has no attribute 'start'"),
        ("probation", " tired"),
        ("probation", " late"),
    ]
    (asked,) = failures[4:]
    assert asked.step == "probation"
    assert "ring position 17 mm is not trained; trained are 0, 4, 8, 12, 16 mm" in asked.text
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert (result["trials_done"], result["trials_unfinished"], result["trials_dropped"]) == (3, 0, [])
