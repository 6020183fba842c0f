"""The estimator node and the library decide stored sweeps alike: filters, features, grids, stop rules.

So does the policy that looks ahead; and a session on a grid of depths reads like any other.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msgs.actuator import RingState
from msgs.experiment import Trial
from msgs.stage import SweepStatus
from msgs.torque import TorqueBlock
from nodes.estimator import Estimator
from palp_core import Bench
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.primitives import fit_cells, quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import Component, RigNoise, write_noise
from palp_core.palpation.perception.belief.trial_filter import TrialReading
from palp_core.palpation.session.filters import filter_of
from palp_core.palpation.session.reanalysis import Methods, readings, reanalyse
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.recorded_sweeps import RecordedSweeps, read_sweeps
from palp_core.palpation.session.trials_csv import read_rows
from palp_core.units import Float64Array
from tests.support.rig_session import ComposedGraph

SIM = str(Path(__file__).resolve().parents[3] / "launch" / "sim.yaml")
NOISE = RigNoise(
    sample_sd_n_m=Component(1.6e-5),
    sweep_sd_n_m=Component(1e-5),
    ring_sd_m=Component(1.7e-4),
    height_sd_m=Component(1e-4),
)


Beliefs = list[tuple[Float64Array, Float64Array]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Beliefs]:
    """Run a session on a grid of depths, six probes a trial; return its folder, and whose beliefs met.

    A pair is the belief that the policy makes of its history, and the estimator's, which it is told.
    """
    folder, met = tmp_path_factory.mktemp("rig"), []
    write_noise(NOISE, folder / "noise.yaml")
    with_classes = latent.Belief.with_classes

    def spy(own: latent.Belief, told: Float64Array) -> latent.Belief:
        if own.offset_mean.size:
            met.append((own.posterior, told))
        return with_classes(own, told)

    with (
        pytest.MonkeyPatch.context() as patch,
        ComposedGraph(
            SIM, record=folder / "bag", out=folder / "out", trials=1, training=3,
            rings_mm="8, 16", policy="information", noise=folder / "noise.yaml",
            overrides=[
                "shared.depths:=31", "shared.filter:=latent", "shared.stop:=fixed_number",
                "shared.stop_value:=6.0",
            ],
        ) as graph,
    ):  # fmt: skip
        patch.setattr(latent.Belief, "with_classes", spy)
        assert graph.run().exit_code == 0
    return folder, met


@pytest.fixture(scope="module")
def folder(run: tuple[Path, Beliefs]) -> Path:
    return run[0]


@pytest.fixture(scope="module")
def session(folder: Path) -> RecordedSweeps:
    return read_sweeps(folder / "out")


def feed(session: RecordedSweeps, **params: Any) -> Iterator[Any]:
    """Give an estimator a session's sweeps as the rig would, and yield its beliefs."""
    bench = Bench(Estimator, params)
    before = -1
    for sweep in session.sweeps:
        if sweep.trial != before:
            taught = sweep.phase == "training"
            depth_m = (sweep.depth_m or 0.0) if taught else 0.0
            bench.feed(
                Estimator.trial,
                Trial(
                    stamp_ns=0, trial=sweep.trial, number=1, phase=sweep.phase, code="", label_known=taught,
                    depth_m=depth_m,
                ),
            )  # fmt: skip
        before = sweep.trial
        for rehome in (True, False) if sweep.landed else (False,):
            bench.feed(
                Estimator.ring,
                RingState(
                    stamp_ns=0, trial=sweep.trial, iteration=sweep.iteration, rehome=rehome,
                    target_m=sweep.ring_m, measured_m=sweep.ring_m, settled=True,
                ),
            )  # fmt: skip
        block = TorqueBlock(
            stamp_ns=0, start_ns=0, rate_hz=sweep.rate_hz, over_phantom=True, saturated_count=0,
            torque_n_m=sweep.torque_n_m,
        )  # fmt: skip
        bench.feed(Estimator.sweep, SweepStatus(stamp_ns=0, goal_id=1, status="sweeping", sample_count=0))
        bench.feed(Estimator.torque, block)
        end = SweepStatus(stamp_ns=0, goal_id=1, status="swept", sample_count=len(sweep.torque_n_m))
        bench.feed(Estimator.sweep, end)
    yield from bench.sent(Estimator.belief)


@pytest.mark.parametrize("depths", [0, 31])
@pytest.mark.parametrize("feature", ["peak", "contrast"])
@pytest.mark.parametrize(
    ("name", "likelihood"),
    [("naive", "normal"), ("naive", "student_t"), ("latent", "normal")],
)
def test_node_and_library_have_the_same_beliefs_to_the_last_bit(
    session: RecordedSweeps, folder: Path, name: str, likelihood: str, feature: str, depths: int
) -> None:
    methods = Methods(
        filter=name, feature=feature, likelihood=likelihood, depth_count=depths, stop="fixed_number"
    )
    training = session.phase("training")
    values = readings(training, methods).tolist()
    cells = [
        (sweep.depth_m or 0.0, sweep.ring_m, value) for sweep, value in zip(training, values, strict=True)
    ]
    primitives = fit_cells(cells, quantisation_sd(RESOLUTION_N_M))
    belief = filter_of(
        primitives, name, likelihood=likelihood, depth_count=depths, feature=feature, noise=NOISE
    )
    estimation = session.phase("estimation")
    values = readings(estimation, methods).tolist()
    probes: list[TrialReading] = []
    library, trial = [], -1
    for sweep, value in zip(estimation, values, strict=True):
        probes = probes if sweep.trial == trial else []
        trial = sweep.trial
        ring = primitives.rings_m.tolist().index(sweep.ring_m)
        probes.append(
            TrialReading(value, ring, bool(sweep.landed) or not probes or ring != probes[-1].setting)
        )
        library.append(belief.posterior(probes))
    node = feed(
        session, filter=name, likelihood=likelihood, feature=feature, depths=depths,
        noise=str(folder / "noise.yaml"), stop="fixed_number", stop_value=6.0,
    )  # fmt: skip
    for said, own in zip(node, library, strict=True):
        np.testing.assert_array_equal(said.posterior, own)
        assert len(said.depths_m) == (depths or 3)


@pytest.mark.parametrize(
    ("stop", "value"),
    [("paper", 0.0), ("paper_guarded", 0.0), ("posterior_threshold", 0.9), ("fixed_number", 3.0)],
)
@pytest.mark.parametrize("name", ["naive", "latent"])
def test_node_and_library_stop_at_the_same_probe(
    session: RecordedSweeps, folder: Path, name: str, stop: str, value: float
) -> None:
    again = reanalyse(session, Methods(filter=name, stop=stop, stop_value=value, max_probes=5), noise=NOISE)
    noise = str(folder / "noise.yaml")
    ended: dict[int, Any] = {}
    for said in feed(session, filter=name, noise=noise, stop=stop, stop_value=value, max_probes=5):
        if ended.get(said.trial) is None or ended[said.trial].verdict == "continue":
            ended[said.trial] = said
    for trial in again.trials:
        said = ended[trial.trial]
        assert (said.verdict, said.iteration) == (trial.verdict, trial.probe_count)
        assert (said.estimate_m, said.confidence) == (trial.estimate_m, trial.confidence)


def test_folder_and_bag_tell_alike_when_the_ring_landed(session: RecordedSweeps, folder: Path) -> None:
    told = [sweep.landed for sweep in session.phase("estimation")]
    assert {True, False} <= set(told) or all(told)
    assert told == [sweep.landed for sweep in read_sweeps(folder / "bag").phase("estimation")]


def test_the_policy_has_the_estimators_own_belief(run: tuple[Path, Beliefs]) -> None:
    """With equal parameters the posterior that the policy makes of its history is the estimator's."""
    _, met = run
    assert len(met) == 3 * 5
    for own, told in met:
        np.testing.assert_array_equal(own, told)


def test_every_belief_is_over_the_grid(folder: Path) -> None:
    beliefs = [row.posterior for row in read_rows(folder / "out") if row.phase == "estimation"]
    assert len(beliefs) == 3 * 6
    assert {len(belief) for belief in beliefs} == {31}


def test_on_a_grid_a_verdict_counts_for_the_nearest_trained_depth(folder: Path) -> None:
    session = read_session(folder / "out")
    assert (session.depths_m, session.grid_count) == ((0.002, 0.004, 0.008), 31)
    for trial in session.trials:
        last = trial.probes[-1]
        assert last.estimate_m in session.depths_m
        assert sum(last.posterior) == pytest.approx(1.0)
        assert 0.0 < trial.confidence <= 1.0


def test_on_a_grid_the_result_tells_the_error_in_mm(folder: Path) -> None:
    out = folder / "out"
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    trials = read_session(out).trials
    assert result["grid_depths"] == 31
    away_m = np.array([trial.mean_m - trial.depth_m for trial in trials])
    assert result["rmse_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(away_m**2)))
    assert result["accuracy"]["overall"]["right"] == sum(trial.right for trial in trials)
    assert (out / "report.html").exists()
