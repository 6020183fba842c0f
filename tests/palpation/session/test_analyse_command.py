"""``palp session reanalyse``: stored sweeps decided again give the run's own verdicts, or others."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
from palp_core.palpation.session.recorded_sweeps import read_sweeps
from tests.support.rig_session import RigSession

FLAT = [[0.4, 0.3, 0.3]] * 4
NOISE = RigNoise(
    sample_sd_n_m=Component(1.6e-5),
    sweep_sd_n_m=Component(1e-5),
    ring_sd_m=Component(1.7e-4),
    height_sd_m=Component(1e-4),
)


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, ["session", "reanalyse", *map(str, arguments)], catch_exceptions=False)


@pytest.fixture
def session(record: Callable[..., Path]) -> Path:
    return record("one", repeats=6, trials=[(truth, FLAT) for truth in (0, 1, 2, 1)])


@pytest.fixture
def rig(rig_session: RigSession) -> tuple[Path, Path]:
    """The folder and the bag of a small session on the simulated rig."""
    return rig_session.out, rig_session.bag


@pytest.mark.parametrize("kind", [0, 1])
def test_the_default_methods_give_the_verdicts_of_the_run(rig: tuple[Path, Path], kind: int) -> None:
    again = reanalyse(read_sweeps(rig[kind]), Methods())
    recorded = read_session(rig[0])
    assert recorded.primitives is not None
    assert np.array_equal(again.primitives.mean, recorded.primitives.mean)
    for new, old in zip(again.trials, recorded.trials, strict=True):
        assert (new.probe_count, new.verdict) == (len(old.probes), old.verdict)
        assert new.estimate_m == old.probes[-1].estimate_m
        assert new.depth_m == old.depth_m
        assert new.confidence == pytest.approx(old.confidence, rel=1e-12)


def test_folder_and_bag_of_a_run_hold_the_same_sweeps(rig: tuple[Path, Path]) -> None:
    folder, bag = (read_sweeps(path) for path in rig)
    for a, b in zip(folder.sweeps, bag.sweeps, strict=True):
        assert (a.phase, a.trial, a.iteration, a.remount, a.depth_m, a.ring_m, a.phantom) == (
            b.phase,
            b.trial,
            b.iteration,
            b.remount,
            b.depth_m,
            b.ring_m,
            b.phantom,
        )
        assert np.array_equal(a.torque_n_m, b.torque_n_m)


def test_a_run_s_folder_and_its_bag_are_one_session(rig: tuple[Path, Path]) -> None:
    with pytest.raises(PalpError, match="a session counts once"):
        run(*rig)


def test_sessions_are_pooled_and_combinations_are_rows(
    session: Path, record: Callable[..., Path], tmp_path: Path
) -> None:
    other = record("two", repeats=6, trials=[(0, FLAT), (2, FLAT)])
    out = tmp_path / "again"
    result = run(session, other, "--stop", "posterior_threshold,fixed_number", "--out", out, "--json")
    found = json.loads(result.stdout)
    assert [row["stop"] for row in found["results"]] == ["posterior_threshold", "fixed_number"]
    quick, slow = found["results"]
    assert quick["trials"] == slow["trials"] == 6
    assert quick["accuracy"]["value"] == 1.0
    assert quick["probes"] < slow["probes"]
    assert slow["ran_out"] == 6  # five probes are asked for, four were stored
    assert quick["difference_to_first"]["value"] == 0.0
    assert "sessions" in found["interval"]
    assert {path.name for path in out.iterdir()} == {"analysis.json", "analysis.csv", "index.html"}
    assert json.loads((out / "analysis.json").read_text()) == found
    assert "2 sessions" in run(session, other).stdout


def test_one_session_says_that_its_interval_is_its_own(session: Path) -> None:
    found = json.loads(run(session, "--denoise", "all", "--json").stdout)
    assert "this session only" in found["interval"]
    assert len(found["results"]) == 2
    assert all(row["accuracy"]["ci"][0] <= row["accuracy"]["value"] for row in found["results"])


def test_the_latent_filter_needs_a_noise_file_and_takes_it(session: Path, tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="--noise"):
        run(session, "--filter", "latent")
    write_noise(NOISE, tmp_path / "noise.yaml")
    found = json.loads(run(session, "--filter", "all", "--noise", tmp_path / "noise.yaml", "--json").stdout)
    assert {row["filter"] for row in found["results"]} == {"naive", "latent"}


def test_the_latent_filter_is_less_sure_of_readings_that_share_an_error(session: Path) -> None:
    stored = read_sweeps(session)
    naive, latent = (
        reanalyse(stored, Methods(filter=name, stop="fixed_number"), noise=NOISE)
        for name in ("naive", "latent")
    )
    assert np.mean([t.confidence for t in latent.trials]) <= np.mean([t.confidence for t in naive.trials])


def test_a_higher_phantom_is_felt_more() -> None:
    shape = (2, 2)
    primitives = Primitives(
        np.array([0.002, 0.008]),
        np.array([0.008, 0.016]),
        np.ones(shape),
        np.ones(shape),
        np.ones(shape),
        0.1,
    )
    slope = height_slope((0.002, 0.008), (0.008, 0.016), "peak", Scene())
    assert (slope > 0.0).all()
    assert (slope[:, 1] > slope[:, 0]).all()
    model = latent_model(primitives, NOISE, slope)
    assert model.offset_sd == pytest.approx([1.7e-4, np.sqrt(2.0) * 1e-4])


def test_what_cannot_be_analysed_says_why(record: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(PalpError, match=r"trials\.csv"):
        run(tmp_path)
    with pytest.raises(PalpError, match="no trial"):
        run(record("training", repeats=2))
    with pytest.raises(PalpError, match="no training"):
        run(record("none", repeats=0, trials=[(0, FLAT)]))
    with pytest.raises(MethodError, match="posterior_threshold"):
        run(record("bad", repeats=2, trials=[(0, FLAT)]), "--stop", "never")


def test_a_noise_file_is_read_back_and_mistakes_are_named(tmp_path: Path) -> None:
    path = tmp_path / "noise.yaml"
    noise = RigNoise(
        sample_sd_n_m=Component(1.6e-5),
        sweep_sd_n_m=Component(1e-5, 8e-6, 1.3e-5),
        ring_sd_m=Component(1.7e-4),
        height_sd_m=Component(1e-4),
        basis="a test",
    )
    write_noise(noise, path)
    assert read_noise(path) == noise
    for text, match in (
        ("ring_sd_m: {value: 1}", "sample_sd_n_m"),
        ("x: 1", "noise file"),
        ("[", "noise file"),
    ):
        path.write_text(text)
        with pytest.raises(PerceptionError, match=match):
            read_noise(path)
    write_noise(
        RigNoise(
            sample_sd_n_m=Component(0.0),
            sweep_sd_n_m=Component(-1.0),
            ring_sd_m=Component(0.0),
            height_sd_m=Component(0.0),
        ),
        path,
    )
    with pytest.raises(PerceptionError, match="sweep_sd_n_m is -1"):
        read_noise(path)


def test_a_session_named_twice_is_refused_for_it_would_count_as_two(session: Path) -> None:
    with pytest.raises(PalpError, match="named twice"):
        run(session, session / ".." / session.name)


def test_trials_that_ran_out_of_stored_sweeps_are_said_beside_a_comparison_without_them(
    session: Path, record: Callable[..., Path]
) -> None:
    assert "ran out of stored sweeps" not in run(session, "--stop", "posterior_threshold").output
    slow = run(session, "--stop", "fixed_number").output  # asks for five, of which four are stored
    assert "Trials ran out of stored sweeps, up to 4 of 4" in slow
    assert "There is no trial that ran out by none" in slow
    longer = record("longer", repeats=6, trials=[(0, FLAT), (2, [*FLAT, FLAT[0]])])
    rules = ("--stop", "posterior_threshold,fixed_number")
    told = json.loads(run(longer, *rules, "--json").output)
    assert told["trials_where_none_ran_out"] == 1
    assert [row["accuracy_where_none_ran_out"] for row in told["results"]] == [1.0, 1.0]
    compared = (
        "Of the 1 trial that ran out by none, no fair draw from all of them: posterior_threshold 100.0 %"
    )
    assert compared in run(longer, *rules).output
