"""``palp emg fit-policy``: a strategy from recordings, within its intervals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.rig.emg import app
from palp_core.errors import PalpError
from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState
from palp_core.palpation.identification.emg.markov_fit import source_of
from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.chain_file import markov_policy
from palp_core.palpation.perception.strategy.markov import (
    eigenvalues,
    kemeny_constant,
    relaxation_time,
    stationary,
)
from palp_core.palpation.perception.strategy.markov_posterior import fit_chain, summarise

RATE_HZ = 1500


def recording(
    matrix: np.ndarray, seed: int, palpation_s: float, **subject: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a simulated subject's MVC, and a trial; volts, shape (2, n) each."""
    source, state, rng = SimEmg(matrix, **subject), SimEmgState(), np.random.default_rng(seed)  # type: ignore[arg-type]
    source.open(0, state, rng)
    begin_ns = source.palpation_ns(state)
    block = source.drain(begin_ns + round(palpation_s * 1e9), state, rng)
    both = np.array([block.fds_v, block.edc_v])
    split = int(np.searchsorted(block.times_ns, begin_ns))
    return both[:, 2 * RATE_HZ : split - 2 * RATE_HZ], both[:, split:]


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(one) for one in arguments], catch_exceptions=False)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("markov")
    mvc, _ = recording(figure5.matrices()[0], 1, 1.0)
    np.savez(folder / "mvc.npz", fds_v=mvc[0], edc_v=mvc[1])
    made = [folder / "mvc.npz"]
    for seed, (depth, depth_mm) in enumerate(((0, 2), (0, 2), (2, 8))):
        path = folder / f"trial{seed}_{depth_mm}mm.npz"
        _, trial = recording(figure5.matrices()[depth], seed, 20.0)
        np.savez(path, fds_v=trial[0], edc_v=trial[1])
        made.append(path)
    return made


def test_a_chain_is_recovered_from_the_simulated_emg_of_that_chain() -> None:
    """A subject who relaxes between levels, so that the rule sees every one of them.

    With the relaxation by half that is the default, a level of less than half the one before is no peak.
    """
    chain = figure5.matrices().mean(axis=0)
    subject = {"relax_share": 0.9, "relax_s": 0.3, "shortest_dwell_s": 0.8, "dwell_s": 1.2}
    used = EmgSettings()
    runs: list[list[int]] = []
    for seed in range(15):
        mvc, trial = recording(chain, seed, 60.0, **subject)
        runs += analyse(trial, mvc, used).runs
    found = summarise(fit_chain(runs, 5), np.random.default_rng(1))
    inside = (found.low <= chain) & (found.high >= chain)
    assert inside.sum() >= 23
    for interval, truth in (
        (found.moduli[1], np.sort(np.abs(eigenvalues(chain)))[-2]),
        (found.relaxation_time, relaxation_time(chain)),
        (found.kemeny, kemeny_constant(chain)),
    ):
        assert interval.low <= truth <= interval.high
    assert np.abs(stationary(found.matrix) - stationary(chain)).sum() < 0.25
    for share, interval in zip(stationary(chain), found.stationary, strict=True):
        assert interval.low <= share <= interval.high


def test_depths_are_taken_from_names_and_each_gets_a_chain(files: list[Path], tmp_path: Path) -> None:
    mvc, *trials = files
    result = run("fit-policy", *trials, "--mvc", mvc, "--fs", RATE_HZ, "--out", tmp_path / "o", "--json")
    record = json.loads(result.stdout)
    assert result.exit_code == 0
    assert [one["depth_mm"] for one in record["chains"]] == [None, 2.0, 8.0]
    assert record["chains"][0]["transitions"] == sum(one["transitions"] for one in record["chains"][1:])
    assert [one["trials"] for one in record["chains"]] == [3, 2, 1]
    for one in record["chains"]:
        low, mean, high = (np.array(one[key]) for key in ("low", "matrix", "high"))
        assert (low <= mean).all()
        assert (mean <= high).all()
    assert {"chain.json", "index.html", "matrices.csv"} < {path.name for path in (tmp_path / "o").iterdir()}
    assert json.loads((tmp_path / "o" / "markov.json").read_text()) == record
    policy = markov_policy(tmp_path / "o" / "chain.json", mixture="posterior", depths_m=(0.008, 0.002))
    assert policy.matrices[1] == pytest.approx(np.array(record["chains"][1]["matrix"]))


def test_a_stated_depth_wins_over_the_name_and_the_text_shows_the_chain(files: list[Path]) -> None:
    mvc, trial, *_ = files
    assert source_of(f"4={trial}").depth_m == 0.004
    text = run("fit-policy", f"4={trial}", "--mvc", mvc, "--fs", RATE_HZ).stdout
    assert text.startswith("all depths:")
    assert "\n4 mm: " in text
    assert "Kemeny" in text


def test_a_folder_of_subjects_is_pooled_and_a_bad_trial_fails_alone(
    files: list[Path], tmp_path: Path
) -> None:
    mvc, first, second, _ = files
    phase = tmp_path / "s1" / "estimation"
    phase.mkdir(parents=True)
    for source, name in ((mvc, "../mvc.npz"), (first, "a_2mm.npz"), (second, "b_2mm.npz")):
        (phase / name).write_bytes(source.read_bytes())
    (phase / "broken_2mm.csv").write_text("fds_v,edc_v\n1,2\n")
    result = run("fit-policy", tmp_path, "--fs", RATE_HZ, "--json")
    assert result.exit_code == 1
    record = json.loads(result.stdout)
    assert [one["trials"] for one in record["chains"]] == [2, 2]
    assert sum(one["error"] is not None for one in record["trials"]) == 1


def test_no_burst_is_an_error_with_the_way_out(files: list[Path]) -> None:
    mvc, trial, *_ = files
    with pytest.raises(PalpError, match="no trial has two peaks"):
        run("fit-policy", trial, "--mvc", mvc, "--fs", RATE_HZ, "--set", "on_share:=0.9")


def test_a_trial_named_twice_is_refused_for_it_would_count_as_two(files: list[Path]) -> None:
    with pytest.raises(PalpError, match="named twice"):
        run("fit-policy", files[1], f"2={files[1]}", "--mvc", files[0], "--fs", RATE_HZ)


def test_a_wrong_setting_is_refused_before_a_folder_is_made(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="--set on_shore: no such setting"):
        run("fit-policy", tmp_path, "--set", "on_shore:=0.9", "--out", tmp_path / "new")
    assert not (tmp_path / "new").exists()
