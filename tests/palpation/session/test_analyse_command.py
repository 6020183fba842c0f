"""``palp session reanalyse``: stored sweeps decided again give the run's own verdicts, or others."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import MethodError, PalpError, PerceptionError
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.rig_noise import (
    Component,
    RigNoise,
    latent_model,
    read_noise,
    write_noise,
)
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.session.reanalysis import Methods, reanalyse
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, read_sweeps
from tests.support.rig_session import RigSession
from tests.support.sessions import Writer

FLAT = [[0.4, 0.3, 0.3]] * 4
NOISE = RigNoise(
    sample_sd_n_m=Component(1.6e-5),
    sweep_sd_n_m=Component(1e-5, 8e-6, 1.3e-5),
    ring_sd_m=Component(1.7e-4),
    height_sd_m=Component(1e-4),
    basis="a test",
)


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, ["session", "reanalyse", *map(str, arguments)], catch_exceptions=False)


@pytest.fixture
def session(record: Writer) -> Path:
    return record("one", repeats=6, trials=[(truth, FLAT) for truth in (0, 1, 2, 1)])


@pytest.mark.parametrize("kind", ["out", "bag"])
def test_the_default_methods_give_the_verdicts_of_the_run(rig_session: RigSession, kind: str) -> None:
    again = reanalyse(read_sweeps(getattr(rig_session, kind)), Methods())
    recorded = read_session(rig_session.out)
    assert recorded.primitives is not None
    assert np.array_equal(again.primitives.mean, recorded.primitives.mean)
    for new, old in zip(again.trials, recorded.trials, strict=True):
        assert (new.probe_count, new.verdict) == (len(old.probes), old.verdict)
        assert (new.estimate_m, new.depth_m) == (old.probes[-1].estimate_m, old.depth_m)
        assert new.confidence == pytest.approx(old.confidence, rel=1e-12)


def test_folder_and_bag_of_a_run_hold_the_same_sweeps_and_are_one_session(rig_session: RigSession) -> None:
    def facts(sweep: RecordedSweep) -> list[object]:
        names = ("phase", "trial", "iteration", "remount", "depth_m", "ring_m", "phantom", "landed")
        return [*(getattr(sweep, name) for name in names), sweep.torque_n_m.tobytes()]

    folder, bag = (
        [facts(one) for one in read_sweeps(path).sweeps] for path in (rig_session.out, rig_session.bag)
    )
    assert folder == bag
    with pytest.raises(PalpError, match="a session counts once"):
        run(rig_session.out, rig_session.bag)


def test_sessions_are_pooled_and_combinations_are_rows(session: Path, record: Writer, tmp_path: Path) -> None:
    other, out = record("two", repeats=6, trials=[(0, FLAT), (2, FLAT)]), tmp_path / "again"
    result = run(session, other, "--stop", "posterior_threshold,fixed_number", "--out", out, "--json")
    found = json.loads(result.stdout)
    assert [row["stop"] for row in found["results"]] == ["posterior_threshold", "fixed_number"]
    quick, slow = found["results"]
    assert quick["trials"] == slow["trials"] == 6
    assert (quick["accuracy"]["value"], quick["difference_to_first"]["value"]) == (1.0, 0.0)
    assert quick["probes"] < slow["probes"]
    assert (quick["ran_out"], slow["ran_out"]) == (0, 6)  # five probes are asked for, four were stored
    assert "sessions" in found["interval"]
    assert {path.name for path in out.iterdir()} == {"analysis.json", "analysis.csv", "index.html"}
    assert json.loads((out / "analysis.json").read_text()) == found
    assert "2 sessions" in run(session, other).stdout


def test_one_session_says_that_its_interval_is_its_own_and_that_trials_ran_out(session: Path) -> None:
    found = json.loads(run(session, "--denoise", "all", "--json").stdout)
    assert "this session only" in found["interval"]
    assert len(found["results"]) == 2
    assert all(row["accuracy"]["ci"][0] <= row["accuracy"]["value"] for row in found["results"])
    assert "ran out of stored sweeps" not in run(session, "--stop", "posterior_threshold").output
    slow = run(session, "--stop", "posterior_threshold,fixed_number").output
    assert re.search(r"Trials ran out of stored sweeps, up to 4 of 4 \(.*/fixed_number\)", slow)


def test_the_latent_filter_needs_a_noise_file_and_is_less_sure_of_readings_that_share_an_error(
    session: Path, tmp_path: Path
) -> None:
    with pytest.raises(PalpError, match="--noise"):
        run(session, "--filter", "latent")
    write_noise(NOISE, tmp_path / "noise.yaml")
    found = json.loads(run(session, "--filter", "all", "--noise", tmp_path / "noise.yaml", "--json").stdout)
    assert {row["filter"] for row in found["results"]} == {"naive", "latent"}
    stored, confidence = read_sweeps(session), {}
    for name in ("naive", "latent"):
        trials = reanalyse(stored, Methods(filter=name, stop="fixed_number"), noise=NOISE).trials
        confidence[name] = np.mean([trial.confidence for trial in trials])
    assert confidence["latent"] <= confidence["naive"]


def test_a_higher_phantom_is_felt_more() -> None:
    depths_m, rings_m, ones = (0.002, 0.008), (0.008, 0.016), np.ones((2, 2))
    primitives = Primitives(np.array(depths_m), np.array(rings_m), ones, ones, ones, 0.1)
    slope = height_slope(depths_m, rings_m, "peak", Scene())
    assert (slope > 0.0).all()
    assert (slope[:, 1] > slope[:, 0]).all()
    model = latent_model(primitives, NOISE, slope)
    assert model.offset_sd == pytest.approx([1.7e-4, np.sqrt(2.0) * 1e-4])


def test_what_cannot_be_analysed_says_why(record: Writer, session: Path, tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    with pytest.raises(PalpError, match="named twice"):
        run(session, session / ".." / session.name)
    with pytest.raises(PalpError, match=r"trials\.csv"):
        run(tmp_path / "none")
    with pytest.raises(PalpError, match="no trial"):
        run(record("training", repeats=2))
    with pytest.raises(PalpError, match="no training"):
        run(record("untrained", repeats=0, trials=[(0, FLAT)]))
    with pytest.raises(MethodError, match="posterior_threshold"):
        run(record("bad", repeats=2, trials=[(0, FLAT)]), "--stop", "never")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("ring_sd_m: {value: 1}", "sample_sd_n_m"),
        ("x: 1", "noise file"),
        ("[", "noise file"),
        ({"sweep_sd_n_m": Component(-1.0)}, "sweep_sd_n_m is -1"),
        (
            {"height_sd_m": Component(0.11)},
            "height_sd_m is 0.11; a standard deviation in SI lies in 0 to 0.1",
        ),
    ],
)
def test_a_noise_file_is_read_back_and_mistakes_are_named(
    text: str | dict[str, Component], match: str, tmp_path: Path
) -> None:
    path = tmp_path / "noise.yaml"
    write_noise(NOISE, path)
    assert read_noise(path) == NOISE
    if isinstance(text, str):
        path.write_text(text)
    else:
        write_noise(msgspec.structs.replace(NOISE, **text), path)
    with pytest.raises(PerceptionError, match=match):
        read_noise(path)
