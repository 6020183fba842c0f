"""A dataset in the Brain Imaging Data Structure: EMG to its last step, events, and the validator's word."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from palp_core.palpation.export.export import write_export
from palp_core.palpation.export.source import ExportSource
from palp_core.palpation.identification.emg.files import read_emg
from palp_core.palpation.session.sheet.sheet import SessionSheet
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from tests.palpation.export.test_export import DEPTHS_M, TRIALS, emg, source_of
from tests.support.sessions import writer

_BESIDE = Path(sys.executable).with_name("bids-validator-deno")
VALIDATOR = shutil.which("bids-validator-deno") or (str(_BESIDE) if _BESIDE.exists() else "")

SHEET = SessionSheet(
    lab="Motor Lab", operator="AB", subject="S-01", ethics="17-204", began="2026-11-22_21-05-09"
)


def dataset(folder: Path, count: int = 750, *, recorded: bool = True) -> tuple[ExportSource, Path]:
    out = writer(folder)(depths_m=DEPTHS_M, trials=TRIALS)
    plain = source_of(out, read_rows(out), emg(count) if recorded else None)
    source = ExportSource(plain.path, plain.tables, SHEET, plain.run, ())
    write_export(source, "bids", folder / "bids")
    return source, folder / "bids"


def tsv(path: Path) -> Any:
    return pd.read_csv(path, sep="\t", na_values=["n/a"], keep_default_na=False)


@pytest.mark.parametrize("count", [750, 751, 1499])
def test_the_emg_is_that_of_the_session_within_a_step_and_lost_samples_are_events(
    tmp_path: Path, count: int
) -> None:
    source, out = dataset(tmp_path, count)
    (file,) = out.rglob("*_emg.bdf")
    assert (
        file.relative_to(out)
        .as_posix()
        .startswith("sub-S01/ses-20261122210509/emg/sub-S01_ses-20261122210509_")
    )
    read = read_emg(file)
    for column, name in zip(read.columns, ("fds_v", "edc_v"), strict=True):
        wanted = 1e6 * source.tables["emg"].values[name]
        step = 2.0 * np.ceil(np.nanmax(np.abs(wanted))) / 2**24
        found = column.samples[:count]
        assert column.rate_hz == 1500.0
        assert column.unit == "uV"
        lost = np.isnan(wanted)
        assert np.abs(found - wanted)[~lost].max() <= step
        assert np.abs(found[lost]).max() <= step
    events = tsv(next(out.rglob("*_emg.bdf")).with_name(file.name.replace("_emg.bdf", "_events.tsv")))
    said = events[events["trial_type"] == "lost"]
    assert said["onset"].iloc[0] == pytest.approx(100 / 1500.0)
    assert said["duration"].iloc[0] == pytest.approx(75 / 1500.0)
    assert list(events["onset"]) == sorted(events["onset"])
    assert (events["trial_type"] == "estimation").sum() == 4
    rows = read_rows(source.path)
    first = events[events["trial_type"] == "training"].iloc[0]
    assert first["onset"] == pytest.approx(rows[0].start_ns / 1e9 - 2.5)


def test_trials_are_behaviour_with_every_column_described(tmp_path: Path) -> None:
    source, out = dataset(tmp_path)
    (file,) = out.rglob("*_beh.tsv")
    table = tsv(file)
    described = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
    assert list(table) == [name for name in described if name != "TaskName"]
    assert described["depth_m"]["Units"] == "m"
    assert np.array_equal(table["depth_m"], source.tables["trials"].values["depth_m"])
    description = json.loads((out / "dataset_description.json").read_text(encoding="utf-8"))
    assert description["EthicsApprovals"] == ["17-204"]


def test_the_torque_of_every_sweep_is_a_run_that_says_when_it_began(tmp_path: Path) -> None:
    source, out = dataset(tmp_path)
    files, rows = sorted(out.rglob("*_physio.tsv.gz")), read_rows(source.path)
    assert len(files) == len(rows)
    for file, row in zip(files, rows, strict=True):
        about = json.loads(file.with_name(file.name.replace(".tsv.gz", ".json")).read_text(encoding="utf-8"))
        torque_n_m, rate_hz = read_sweep(source.path, row.row)
        assert about["Columns"] == ["torque_n_m"]
        assert np.array_equal(np.loadtxt(file), torque_n_m)
        assert (about["Row"], about["Trial"], about["SamplingFrequency"]) == (row.row, row.trial, rate_hz)
        assert about["StartTime"] == row.start_ns / 1e9 - 2.5


needs_validator = pytest.mark.skipif(not VALIDATOR, reason="needs bids-validator-deno")


def issues(folder: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the errors that BIDS's own validator finds in a dataset, and its summary."""
    done = subprocess.run(
        [VALIDATOR, folder, "--format", "json"], capture_output=True, text=True, check=False
    )
    found = json.loads(done.stdout)
    return [one for one in found["issues"]["issues"] if one["severity"] == "error"], found["summary"]


@needs_validator
@pytest.mark.nightly
@pytest.mark.parametrize("recorded", [True, False])
def test_the_validator_of_bids_finds_no_error(tmp_path: Path, *, recorded: bool) -> None:
    _, out = dataset(tmp_path, recorded=recorded)
    errors, summary = issues(out)
    assert errors == []
    assert summary["subjects"] == ["S01"]
    assert ("emg" in summary["dataTypes"]) is recorded


@needs_validator
@pytest.mark.nightly
def test_the_validator_of_bids_finds_what_is_broken(tmp_path: Path) -> None:
    _, out = dataset(tmp_path)
    (sidecar,) = out.rglob("*_emg.json")
    said = json.loads(sidecar.read_text(encoding="utf-8"))
    del said["EMGPlacementScheme"]
    sidecar.write_text(json.dumps(said), encoding="utf-8")
    errors, _ = issues(out)
    assert errors
