"""``policy:=bitrate`` in whole runs: what is chosen is what a study would choose, and beliefs are its own."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nodes.choosing.bitrate import BitrateParams, choices_of
from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.replay.replay import replay
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.perception.trace.actions import SweepAction
from palp_core.palpation.session.reanalysis import Methods, reanalyse
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps, read_sweeps
from palp_core.palpation.session.trace.action_time import ActionTime
from palp_core.palpation.session.trace.actions import action_model
from palp_core.palpation.session.trace.again import decide_again, felt_of, trace_reader, trained_by
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.palpation.session.trials_csv import Row, read_rows
from palp_core.palpation.studies.frontier.action_trials import run_action_trials
from palp_core.units import Float64Array
from tests.support.palp import Palp, palp
from tests.support.rig_session import ComposedGraph, check_here

__all__ = ["palp"]

ROOT = Path(__file__).resolve().parents[2]
SIM = ROOT / "launch" / "sim.yaml"
RINGS_M = (0.012, 0.016)
SETTINGS = {"protocol": "swift", "rings_mm": "12, 16", "training": 2}
MOST = 0.99


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two trials a phantom; a threshold that one sweep seldom passes, so that some take a second."""
    path = tmp_path_factory.mktemp("action")
    with ComposedGraph(
        SIM, record=path / "bag", out=path / "out", **SETTINGS, trials=2, policy="bitrate",
        overrides=[f"shared.stop_value:={MOST}", "shared.max_probes:=6"],
    ) as graph:  # fmt: skip
        assert graph.run().exit_code == 0
    return path


@pytest.fixture(scope="module")
def session(folder: Path) -> RecordedSweeps:
    return read_sweeps(folder / "bag")


@pytest.fixture(scope="module")
def rows(folder: Path) -> list[Row]:
    return [row for row in read_rows(folder / "out") if row.phase == "estimation"]


def action_of(row: Row) -> SweepAction:
    numbers = (row.indentation_m, row.speed_m_s, row.from_m, row.to_m)
    assert None not in numbers
    return SweepAction(row.ring_m, *numbers)  # type: ignore[arg-type]


class Felt:
    """The trials of a session as a study's: what it feels is what the rig has felt."""

    def __init__(self, rows: list[Row], sweeps: dict[tuple[int, int], list[float]]) -> None:
        self.rows, self.sweeps = rows, sweeps
        self.trials = sorted({row.trial for row in rows})
        self.depths_m = (0.002, 0.004, 0.008)
        of = {row.trial: self.depths_m.index(row.depth_m) for row in rows}
        self.depth = np.array([of[trial] for trial in self.trials])
        self.landings_m = np.zeros((len(self.trials), 15))
        self.plan = SimpleNamespace()
        self.asked: dict[tuple[int, int], SweepAction] = {}

    def swept(self, action: SweepAction, trials: Any, error_m: Float64Array, probe: int) -> Float64Array:
        """Return the recorded bins, each twice as the study's are finer; beyond a decision none counts."""
        felt = np.zeros((len(trials), 30))
        for row, trial in enumerate(trials):
            of = (self.trials[trial], probe + 1)
            self.asked[of] = action
            bins = self.sweeps[of]
            felt[row, : len(bins)] = bins
        return np.repeat(felt, 2, axis=1)


def test_live_and_batch_choose_alike_and_believe_the_same_to_the_last_bit(
    session: RecordedSweeps, rows: list[Row]
) -> None:
    settings = TraceSettings.of(session.read_by)
    params = BitrateParams(from_m=-0.026, to_m=0.034, lift_mm=6.0, rehome="never", trained_mm="12, 16")
    actions = choices_of(params).actions(RINGS_M)
    assert len(actions) == 2 * 2 * 2 * 8
    known = action_model(settings, trained_by(session, settings), actions)
    felt = Felt(rows, {of: one.torque_n_m for of, one in felt_bins(session, settings).items()})
    times = ActionTime(SimStage(lift_m=0.006), Timing(rehomes=False))
    batch = run_action_trials(felt, known, times, threshold=MOST, most=6)  # type: ignore[arg-type]
    assert felt.asked == {(row.trial, row.iteration): action_of(row) for row in rows}
    ends = [row for row in rows if row.verdict != "continue"]
    assert [max(row.posterior) for row in ends] == batch.ended.confidence.tolist()
    assert [row.iteration for row in ends] == batch.ended.probes.tolist()
    assert any(action_of(row).speed_m_per_s == 0.04 for row in rows)


def felt_bins(session: RecordedSweeps, settings: TraceSettings) -> dict[tuple[int, int], Any]:
    """Return the bins of each sweep of estimation, up to where it was stopped."""
    return {
        (one.trial, one.iteration): felt_of(session, one, settings).felt(settings, one.ring_m, landed=False)
        for one in session.phase("estimation")
    }


def test_the_record_and_the_bag_tell_how_each_sweep_was_made(folder: Path, rows: list[Row]) -> None:
    kept, told = (read_sweeps(folder / kind).sweeps for kind in ("out", "bag"))
    assert [one.terms for one in kept] == [one.terms for one in told]
    assert all(one.terms is None for one in kept if one.phase == "training")
    assert {len(row.posterior) for row in rows} == {3}
    swept: list[RecordedSweep] = [one for one in kept if one.phase == "estimation"]
    assert all(one.terms is not None for one in swept)


@pytest.mark.parametrize("kind", ["out", "bag"])
def test_stored_trials_are_decided_again_as_they_were(folder: Path, rows: list[Row], kind: str) -> None:
    session = read_sweeps(folder / kind)
    settings = TraceSettings.of(session.read_by)
    reader, rule = trace_reader(session, settings, None, None), stop_rule("posterior_threshold", MOST)
    again = list(decide_again(session, reader, settings, rule, 6))
    found = [one.tolist() for trial in again for one in trial.posteriors]
    np.testing.assert_allclose(found, [row.posterior for row in rows], atol=1e-9)
    ends = [row.verdict for row in rows if row.verdict != "continue"]
    assert [trial.word for trial in again] == ends


def test_palp_analyse_decides_chosen_sweeps_by_the_trace_and_by_no_feature(
    session: RecordedSweeps, rows: list[Row]
) -> None:
    swift = Methods(stop="posterior_threshold", stop_value=MOST, trace_filter="second_order")
    again = reanalyse(session, swift)
    ends = [row for row in rows if row.verdict == "decided"]
    assert [trial.estimate_m for trial in again.trials] == [row.estimate_m for row in ends]
    with pytest.raises(PalpError, match="decide them by the whole trace"):
        reanalyse(session, Methods())


def test_replayed_nodes_say_the_same_again(folder: Path) -> None:
    for one in replay(folder / "bag", ["policy", "estimator", "stage", "phantom", "actuator"], ROOT):
        assert one.divergence is None, one.divergence
        assert one.compared > 0


def test_estimator_policy_and_phantom_swapped_in_the_midst_of_sweeps_change_nothing(
    rows: list[Row], tmp_path: Path
) -> None:
    swapped = [
        ("estimator", "nodes.estimator:Estimator"),
        ("policy", "nodes.choosing.bitrate:Bitrate"),
        ("phantom", "nodes.phantom:Phantom"),
    ]
    with ComposedGraph(
        SIM, out=tmp_path / "out", **SETTINGS, trials=2, policy="bitrate",
        overrides=[f"shared.stop_value:={MOST}", "shared.max_probes:=6"],
    ) as graph:  # fmt: skip
        for row, (node, run) in zip(rows[1:], swapped, strict=False):
            graph.plan_swap(row.start_ns * 1e-9 + 0.2, node, run)
        assert graph.run().exit_code == 0
    again = [row for row in read_rows(tmp_path / "out") if row.phase == "estimation"]
    assert again == rows


@pytest.mark.nightly
def test_policies_swapped_in_mid_trial_go_on_and_it_takes_over_again(tmp_path: Path) -> None:
    swaps = "2=nodes.choosing.bitrate:Bitrate,3=nodes.policy_fixed:Fixed"
    with ComposedGraph(
        SIM, record=tmp_path / "bag", out=tmp_path / "out", **SETTINGS, trials=2,
        policy="bitrate",
        swaps=swaps, overrides=["shared.vary:=speed, direction"],
    ) as graph:  # fmt: skip
        assert graph.run().exit_code == 0
    rows = [row for row in read_rows(tmp_path / "out") if row.phase == "estimation"]
    ends = [row for row in rows if row.verdict != "continue"]
    assert len(ends) == 6
    assert [row.policy for row in ends[:2]] == ["bitrate", "bitrate"]
    assert ends[-1].policy == "fixed"
    assert all(row.speed_m_s == 0.04 for row in ends[:2])
    assert [row.speed_m_s for row in ends[3:]] == [None] * 3  # as the launch file says
    with Bag(tmp_path / "bag") as bag:
        told = [one.value.asked for one in bag.messages(["/stage/action"])]
    assert told[0]
    assert not told[-1]


@pytest.mark.nightly
def test_processes_and_one_process_give_the_same_bytes(palp: Palp, tmp_path: Path) -> None:
    digests: list[str] = []
    for how in ((), ("--compose",)):
        to = tmp_path / f"digest{len(digests)}.json"
        given = ("protocol:=swift", "policy:=bitrate", "trials:=1", "training:=2", "rings_mm:=12, 16")
        out = (f"out:={tmp_path / 'out'}", "overwrite:=true")
        done = palp.run("launch", SIM, "--digest", to, *how, *given, *out)
        assert done.returncode == 0, done.stderr
        digests.append(to.read_text(encoding="utf-8"))
    assert digests[0] == digests[1]
    assert "/stage/action" in digests[0]


@pytest.mark.nightly
def test_emulated_devices_take_what_is_chosen_and_nothing_trips(palp: Palp, tmp_path: Path) -> None:
    out, host = tmp_path / "out", f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.12"
    lenient = (
        "shared.stale_ms:=10000.0",
        "shared.beat_ms:=10000.0",
        "shared.link_ms:=20000.0",
        "answer_s:=20.0",
    )
    small = (
        "trials:=1",
        "training:=1",
        "rings_mm:=8, 16",
        "shared.trace_filter:=linear",
        "shared.stop_value:=0.9",
    )
    given = ("protocol:=swift", "policy:=bitrate", *small, f"host:={host}", f"out:={out}")
    emulated = ROOT / "launch" / "emulated.yaml"
    done = palp.run("launch", emulated, *given, *lenient, "--record", tmp_path / "bag")
    assert done.returncode == 0, done.stderr
    rows = [row for row in read_rows(out) if row.phase == "estimation"]
    assert len({row.trial for row in rows}) == 3
    for row in rows:
        action, swept_s = action_of(row), (row.end_ns - row.start_ns) * 1e-9
        assert swept_s < action.way_m / action.speed_m_per_s + 0.5
    with Bag(tmp_path / "bag") as bag:
        assert "/stage/action" in bag.topics()
        assert list(bag.messages(["/safety/trip"] if "/safety/trip" in bag.topics() else [])) == []


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml"])
def test_what_may_vary_is_one_argument(file: str) -> None:
    graph = check_here(
        ROOT / "launch" / file, ["protocol:=swift", "policy:=bitrate", "shared.vary:=speed", "out:=results"]
    )
    by_name = {spec.name: spec.params for spec in graph.nodes}
    policy, stage = by_name["policy"], by_name["stage"]
    assert policy["vary"] == "speed"
    for name in ("from_m", "to_m", "lift_mm", "sweep_speed_m_s"):
        assert policy[name] == stage[name]
