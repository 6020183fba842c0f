import csv
import functools
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from msgs.emg import EmgBlock
from palp_core.cli.rig import emg
from palp_core.cli.rig.emg import app
from palp_core.errors import PalpError
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState
from palp_core.palpation.identification.emg.files import read_emg
from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
from palp_core.palpation.perception.strategy import figure5
from tests.support.bags import describe, frame
from tests.support.rig_messages import emg_block

RATE_HZ = 1500.0
TRIAL_S = 9.0


@functools.cache
def subject(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a simulated subject's MVC with the rests around it, and a trial; volts, shape (2, n) each."""
    source = SimEmg(figure5.matrices().mean(axis=0))
    state, rng = SimEmgState(), np.random.default_rng(seed)
    source.open(0, state, rng)
    begin_ns = source.palpation_ns(state)
    block = source.drain(begin_ns + round(TRIAL_S * 1e9), state, rng)
    both = np.array([block.fds_v, block.edc_v])
    both.flags.writeable = False
    split = int(np.searchsorted(block.times_ns, begin_ns))
    return both[:, :split], both[:, split:]


def write(path: Path, both: np.ndarray, factor: float = 1e6, unit: str = "uV") -> Path:
    """Write an archive, which is read in a fraction of the time that text takes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = [f"{name} ({unit})" if unit else name for name in ("fds", "edc")]
    np.savez(path, **dict(zip(names, factor * both, strict=True)))
    return path


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(one) for one in arguments], catch_exceptions=False)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    mvc, trial = subject(0)
    folder = tmp_path_factory.mktemp("recording")
    return write(folder / "trial.npz", trial), write(folder / "mvc.npz", mvc)


def test_a_trial_is_analysed_as_the_library_does(recording: tuple[Path, Path], tmp_path: Path) -> None:
    trial, mvc = recording
    chosen = ("--fs", 1500, "--fds", "fds", "--edc", "edc", "--mvc", mvc)
    result = run("analyse", trial, *chosen, "--out", tmp_path / "o", "--json")
    found = json.loads(result.stdout)
    effort, samples = subject(0)
    expected = analyse(samples, effort, EmgSettings())
    assert found["flags"] == list(expected.flags)
    assert found["burst_count"] == len(expected.bursts) >= 1
    assert found["peak_count"] == len(expected.peaks) > 5
    assert found["reference"] == pytest.approx(expected.reference, rel=1e-6)
    assert found["cocontraction_mean"] == pytest.approx(expected.cocontraction.mean(), rel=1e-6)
    names = sorted(one.name for one in (tmp_path / "o").iterdir())
    assert names == [
        *(f"cocontraction.{kind}" for kind in ("csv", "png", "svg")),
        *("quality.csv", "quality.html", "quality.json", "series.csv"),
    ]
    series = np.loadtxt(tmp_path / "o" / "series.csv", delimiter=",", skiprows=1)
    assert series.shape == (samples.shape[1], 4)


def test_without_an_mvc_it_is_asked_for(recording: tuple[Path, Path]) -> None:
    with pytest.raises(PalpError, match="--mvc"):
        run("analyse", recording[0], "--fs", 1500)
    with pytest.raises(PalpError, match="--fs"):
        run("analyse", recording[0], "--mvc", recording[1])


def test_import_shows_what_is_used_and_where_it_stands(recording: tuple[Path, Path], tmp_path: Path) -> None:
    found = json.loads(run("import", recording[0], "--dry-run", "--fs", 1500, "--json").stdout)
    assert (found["fds"], found["edc"], found["unit"]) == ("0 'fds' [uV]", "1 'edc' [uV]", "V")
    assert (found["rate_hz"], found["rate_from"], found["time"]) == (1500.0, "--fs", None)
    assert [one["index"] for one in found["columns"]] == [0, 1]
    assert "FDS by name" in run("import", recording[0], "--dry-run", "--fs", 1500).stdout
    with pytest.raises(PalpError, match="sampling rate"):
        run("import", recording[0], "--dry-run")
    run("import", recording[0], "--fs", 1500, "--out", tmp_path / "plain.csv")
    again = json.loads(run("import", tmp_path / "plain.csv", "--dry-run", "--json").stdout)
    assert again["rate_hz"] == pytest.approx(1500.0)
    assert (again["unit"], again["time"]) == ("V", "0 'time_s' [s]")


def test_a_folder_is_a_batch_with_one_quality_page(tmp_path: Path) -> None:
    root, out = tmp_path / "study \udcff", tmp_path / "out"  # bytes that are not UTF-8
    for number, name in enumerate(("s1", "s2")):
        mvc, trial = subject(number)
        write(root / name / "mvc.npz", mvc)
        write(root / name / "training" / "01.npz", trial[:, :9000])
        write(root / name / "estimation" / "01.npz", trial[:, 9000:])
    holed = subject(0)[1].copy()
    holed[:, 3000:3300] = np.nan
    write(root / "s1" / "training" / "02.npz", holed)
    (root / "s2" / "training" / "02\udcff.csv").write_text("no numbers\n")
    result = run("analyse", root, "--fs", 1500, "--out", out, "--json")
    assert result.exit_code == 1
    found = json.loads(result.stdout)
    assert [(one["subject"], one["phase"], one["trial"]) for one in found["trials"]] == [
        (name, phase, number)
        for name in ("s1", "s2")
        for phase, number in (
            ("estimation", "01"),
            ("training", "01"),
            ("training", "02" if name == "s1" else "02\udcff"),
        )
    ]
    assert "lost_samples" in found["trials"][2]["flags"]
    assert "no table" in found["trials"][5]["error"]
    assert json.loads((out / "quality.json").read_text()) == found
    assert len(list(csv.DictReader((out / "quality.csv").read_text().splitlines()))) == 6
    page = (out / "quality.html").read_text()
    assert "lost_samples" in page
    assert r"02\udcff" in page


def bag_of(folder: Path, blocks: list[EmgBlock]) -> Path:
    recorder = BagRecorder(BagWriter(folder))
    recorder.describe(describe(EmgBlock, "/emg/block"))
    for number, block in enumerate(blocks, 1):
        recorder(block.stamp_ns, frame("/emg/block", block, number, block.stamp_ns))
    recorder.close()
    return folder


def test_a_bag_brings_its_own_mvc_and_a_lost_block_is_a_gap(tmp_path: Path) -> None:
    mvc, trial = subject(2)
    both, blocks = np.concatenate([mvc, trial], axis=1), []
    for at in range(0, both.shape[1], 75):
        phase = "palpation" if at >= 9 * 1500 else "mvc" if 3000 <= at < 7 * 1500 else "rest"
        part = both[:, at : at + 75]
        blocks.append(emg_block(round(at / RATE_HZ * 1e9), phase, *part))
    whole = json.loads(run("analyse", bag_of(tmp_path / "whole", blocks), "--json").stdout)
    assert "lost_samples" not in whole["flags"]
    assert whole["duration_s"] == pytest.approx(TRIAL_S, abs=0.06)
    del blocks[250]
    holed = json.loads(run("analyse", bag_of(tmp_path / "holed", blocks), "--json").stdout)
    assert "lost_samples" in holed["flags"]
    assert holed["lost"] == 150  # 75 of each muscle
    assert read_emg(tmp_path / "holed").format == "bag"
    shutil.rmtree(tmp_path / "holed")


@pytest.mark.parametrize(
    ("starts_s", "rates_hz", "words"),
    [
        ([0.0, 1.0], [100.0, 200.0], r"/emg/block changes its rate: \[100\.0, 200\.0\] Hz"),
        ([0.0, 0.5], [100.0, 100.0], "blocks of /emg/block overlap; it was recorded from two sources"),
        ([0.0, 99.0], [100.0, 100.0], "9800 samples of /emg/block are missing; split the bag"),
        ([], [], "needs one topic of EMG blocks"),
    ],
)
def test_a_bag_that_is_no_one_recording_is_refused(
    tmp_path: Path, starts_s: list[float], rates_hz: list[float], words: str
) -> None:
    part = np.zeros(100)
    blocks = [
        emg_block(round(1e9 * at), "", part, part, rate_hz=hz)
        for at, hz in zip(starts_s, rates_hz, strict=True)
    ]
    with pytest.raises(PalpError, match=words):
        read_emg(bag_of(tmp_path / "bag", blocks))


def test_units_and_rates_that_do_not_fit_are_refused(recording: tuple[Path, Path], tmp_path: Path) -> None:
    mvc, _ = subject(0)
    other = write(tmp_path / "counts.npz", mvc, 1.0, "counts")
    with pytest.raises(PalpError, match="is in counts, the trial is in V; state the unit of both"):
        run("analyse", recording[0], "--fs", 1500, "--mvc", other)
    np.savez(tmp_path / "mvc.npz", fds=mvc[0], edc=mvc[1], fs=1000.0)
    np.savez(tmp_path / "trial.npz", fds=mvc[0], edc=mvc[1], fs=1500.0)
    with pytest.raises(PalpError, match="resample"):
        run("analyse", tmp_path / "trial.npz", "--mvc", tmp_path / "mvc.npz")


@pytest.mark.parametrize(("factor", "unit"), [(1e6, "mV"), (1.0, "uV")])
def test_a_unit_that_the_numbers_contradict_is_refused_until_the_user_states_it(
    tmp_path: Path, factor: float, unit: str
) -> None:
    mvc, trial = subject(0)
    files = [write(tmp_path / name, one, factor, unit) for name, one in (("t.npz", trial), ("m.npz", mvc))]
    true = {1.0: "V", 1e6: "uV"}[factor]
    asked = ("analyse", files[0], "--fs", 1500, "--mvc", files[1], "--json")
    with pytest.raises(PalpError, match=rf"t\.npz: unit is {unit}, but .* --unit"):
        run(*asked)
    with pytest.raises(PalpError, match=r"t\.npz: unit is .* --unit"):
        run("import", files[0], "--fs", 1500, "--dry-run")
    found = json.loads(run(*asked, "--unit", true).stdout)
    expected = analyse(trial, mvc, EmgSettings(rate_hz=1500.0))
    assert found["maxima"]["fds"] == pytest.approx(expected.maxima[0], rel=1e-6)
    assert f"--unit says {true}, the file {unit}" in found["notes"]
    assert found["unit_from"] == "--unit"
    assert "uV" in run("import", files[0], "--fs", 1500, "--dry-run", "--unit", "uV").stdout
    with pytest.raises(PalpError, match="no unit of EMG"):
        run(*asked, "--unit", "kg")


@pytest.mark.parametrize("unit", ["V", ""])
def test_an_amplifiers_output_in_volts_and_true_units_pass(tmp_path: Path, unit: str) -> None:
    mvc, trial = subject(0)
    factor = {"V": 1e3, "": 1e6}[unit]
    files = [write(tmp_path / name, one, factor, unit) for name, one in (("t.npz", trial), ("m.npz", mvc))]
    found = json.loads(run("analyse", files[0], "--fs", 1500, "--mvc", files[1], "--json").stdout)
    assert found["flags"] == []


@pytest.mark.parametrize(("of_trial", "of_mvc"), [(1e3, 1e6), (1e6, 1e3)])
def test_an_mvc_in_another_unit_than_the_trial_is_refused(
    tmp_path: Path, of_trial: float, of_mvc: float
) -> None:
    mvc, trial = subject(0)
    trial_file = write(tmp_path / "t.npz", trial, of_trial, "")
    mvc_file = write(tmp_path / "m.npz", mvc, of_mvc, "")
    asked = ("analyse", trial_file, "--fs", 1500, "--mvc", mvc_file, "--json")
    with pytest.raises(PalpError, match=r"m\.npz: this MVC is .* times as strong as .*t\.npz.* --unit"):
        run(*asked)
    flags = json.loads(run(*asked, "--unit", "uV").stdout)["flags"]
    assert ("above_mvc" in flags) == (of_trial > of_mvc)


def test_a_weak_trial_and_one_bad_electrode_are_flagged_and_not_refused(tmp_path: Path) -> None:
    mvc, trial = subject(0)
    mvc_file = write(tmp_path / "m.npz", mvc, 1e3, "mV")
    weak = write(tmp_path / "weak.npz", 5.0 * trial, 1e3, "mV")
    found = json.loads(run("analyse", weak, "--fs", 1500, "--mvc", mvc_file, "--json").stdout)
    assert "above_mvc" in found["flags"]
    hum = trial + np.array([[0.0], [0.1]]) * np.sin(2 * np.pi * 500.0 * np.arange(trial.shape[1]) / 1500.0)
    loose = write(tmp_path / "loose.npz", hum, 1e3, "mV")
    found = json.loads(run("analyse", loose, "--fs", 1500, "--mvc", mvc_file, "--json").stdout)
    assert "above_mvc" in found["flags"]


def test_one_muscle_is_analysed_by_itself(recording: tuple[Path, Path], tmp_path: Path) -> None:
    trial, mvc = recording
    files = [tmp_path / "trial.txt", tmp_path / "mvc.txt"]
    for path, both in zip(files, reversed(subject(0)), strict=True):
        np.savetxt(path, 1e6 * both[0], fmt="%.6f", header="Labels:= EMG\nengineering units: uV")
    alone = ["--fds", 0, "--edc", "none"]
    asked = ["analyse", files[0], "--fs", 1500, "--mvc", files[1], *alone]
    found = json.loads(run(*asked, "--out", tmp_path / "o", "--json").stdout)
    assert f"{files[1]}: one muscle only" in "".join(found["notes"])
    effort, samples = subject(0)
    expected = analyse(samples[:1], effort[:1], EmgSettings())
    assert found["edc"] is None
    assert list(found["maxima"]) == ["fds"]
    assert found["reference"] == pytest.approx(expected.reference, rel=1e-6)
    assert found["peak_count"] == len(expected.peaks) > 5
    assert (tmp_path / "o" / "series.csv").read_text().startswith("time_s,fds_of_mvc,cocontraction\n")
    assert "one muscle only" in run(*asked).stdout
    run("import", files[0], "--fs", 1500, *alone, "--out", tmp_path / "plain.csv")
    assert (tmp_path / "plain.csv").read_text().startswith("time_s,fds_v\n")
    again = json.loads(run("analyse", trial, "--fs", 1500, "--mvc", mvc, "--edc", "none", "--json").stdout)
    assert again["peak_count"] == found["peak_count"]


def test_rules_of_the_mvc_and_of_levels_are_the_users(recording: tuple[Path, Path]) -> None:
    trial, mvc = recording
    asked = ["analyse", trial, "--fs", 1500, "--mvc", mvc, "--json"]
    found = {
        rule: json.loads(run(*asked, "--set", f"mvc_rule:={rule}").stdout)
        for rule in ("plateau", "maximum_of_sum", "sum_of_maxima")
    }
    scales = [one["reference"] for one in found.values()]
    assert scales == sorted(scales)
    assert [one["settings"]["mvc_rule"] for one in found.values()] == list(found)
    peak = json.loads(run(*asked, "--set", "level_rule:=peak").stdout)["peaks"]
    assert [one["strength"] for one in peak] == [one["value"] for one in peak]
    railed = json.loads(run(*asked, "--set", "rails:=[-1e-4, 1e-4]", "--set", "low_hz:=30").stdout)
    assert "clipping" in railed["flags"]
    assert railed["settings"]["low_hz"] == 30.0
    rule = ("on_share:=0.4", "off_share:=0.3", "gap_s:=0", "least_s:=0.3")
    stricter = json.loads(run(*asked, *(word for one in rule for word in ("--set", one))).stdout)
    assert stricter["burst_count"] > found["plateau"]["burst_count"]


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        ("off_share:=0.3", r"off at 0\.3 and on at 0\.05"),
        ("gap:=0.1", "--set gap: no such setting.*gap_s"),
        ("gap_s:=short", r"--set: bursts\.gap_s must be a number, not a text"),
        ("gap_s:=.nan", "gap_s is nan; it must be 0 or more, and finite"),
        ("gap_s=0.1", "--set gap_s=0.1: write name:=value"),
    ],
)
def test_a_setting_of_the_burst_rule_that_does_not_fit_is_refused(
    recording: tuple[Path, Path], rule: str, words: str
) -> None:
    with pytest.raises(PalpError, match=words):
        run("analyse", recording[0], "--fs", 1500, "--mvc", recording[1], "--set", rule)


def test_node_and_command_have_one_set_of_defaults() -> None:
    from nodes.cocontraction import CoContractionParams

    params = CoContractionParams()
    assert params.bursts == EmgSettings().bursts
    assert (params.window_s, params.mvc_rule, params.level_rule) == (
        EmgSettings().window_s,
        EmgSettings().mvc_rule,
        EmgSettings().level_rule,
    )
    assert emg.emg_settings(None) == EmgSettings()
