"""``report.html`` and the charts of a session, whatever its record lacks."""

from __future__ import annotations

import base64
import csv
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import MethodSpan
from palp_core.palpation.reporting.charts import Chart, image
from palp_core.palpation.session.methods.used import used
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.report import charts_of, session, write
from palp_core.palpation.session.run_note import read_note
from tests.support.rig_session import RigSession
from tests.support.sessions import SMALL_STRAIN, Summariser, Writer, charts_in, describe, no_charts, writer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRIALS = [
    (0, [[0.6, 0.3, 0.1], [0.9, 0.1, 0.0]]),
    (0, [[0.8, 0.1, 0.1]]),
    (1, [[0.2, 0.6, 0.2]]),
    (2, [[0.1, 0.6, 0.3], [0.1, 0.7, 0.2], [0.1, 0.8, 0.1]]),
]
ALL = {"accuracy", "belief", "calibration", "primitives", "rings", "steps", "sweeps"}


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a session with its report, for tests that only read it; its charts are blank."""
    out = writer(tmp_path_factory.mktemp("reported"))(trials=TRIALS)
    with no_charts():
        write(out, describe(out), files=True)
    return out


@pytest.fixture(scope="module")
def complete(rig_session: RigSession, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the page of a session with all its charts."""
    out = tmp_path_factory.mktemp("complete") / "out"
    shutil.copytree(rig_session.out, out)
    write(out, read_note(out))
    return page_of(out)


def page_of(out: Path) -> str:
    return (out / "report.html").read_text(encoding="utf-8")


def charts(out: Path) -> set[str]:
    return charts_in(out / "report.html")


def numbers(out: Path, name: str) -> list[dict[str, str]]:
    with (out / "charts" / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_run_leaves_a_page_of_accuracies_and_a_report_that_is_asked_for_every_chart(
    rig_session: RigSession, complete: str
) -> None:
    out = rig_session.out
    assert (out / "result.json").exists()
    assert charts(out) == {"accuracy"}
    assert "palp session report /" in page_of(out)
    assert set(re.findall(r'data-name="(\w+)"', complete)) == ALL
    assert not (out / "charts").exists()
    assert not list(out.rglob("*.part"))


def test_the_page_needs_no_other_file(complete: str) -> None:
    pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', complete)
    assert len(pictures) == len(ALL) - 1  # accuracies are drawn by the page itself
    assert all(b"<svg" in base64.b64decode(one) for one in pictures)
    assert len(complete) < 2_000_000
    assert "http" not in re.sub(r"base64,[^\"]+", "", complete)


@pytest.mark.usefixtures("blank_charts")
def test_the_page_states_the_session_and_the_reach_of_its_intervals(
    record: Writer, summary: Summariser
) -> None:
    shown = session(summary(out := record(trials=TRIALS)))
    page = page_of(out)
    assert shown.splitlines()[0] in page
    assert shown.endswith(f"Report: {out / 'report.html'}")
    for words in (
        "found the right depth in 3 of 4 trials: 75.0 %",
        "speak for this session only",
        "slightly above 90 %",
        "eigenvalues published, entries not legible",
    ):
        assert words in page


def test_the_page_begins_with_versions_and_the_command_and_has_every_trial(reported: Path) -> None:
    top, _, rest = page_of(reported).partition("<h2")
    assert f"palp launch launch/sim.yaml out:={reported} trials:=2 training:=2<" in top
    assert "numpy " in top
    table = rest[rest.index("Every trial") :]
    cells = "<td>1003</td><td>C</td><td>8 mm</td><td>3</td><td>16, 0, 16</td><td>4 mm</td><td>wrong</td>"
    assert cells in table
    assert table.count("<td>decided</td>") == len(TRIALS)


def test_a_trial_that_has_ended_keeps_its_last_belief(reported: Path) -> None:
    at_2mm = [row for row in numbers(reported, "belief") if row["depth_mm"] == "2"]
    assert [int(row["trials_running"]) for row in at_2mm] == [2, 2, 1, 0]
    second = 0.8 * 2 + 0.1 * 4 + 0.1 * 8
    expected = [14 / 3, (0.6 * 2 + 0.3 * 4 + 0.1 * 8 + second) / 2, *2 * [(0.9 * 2 + 0.1 * 4 + second) / 2]]
    assert [float(row["expected_depth_mm"]) for row in at_2mm] == pytest.approx(expected)


def test_ring_positions_are_counted_by_iteration(reported: Path) -> None:
    counts = [list(map(int, row.values())) for row in numbers(reported, "rings")]
    assert counts == [[1, 0, 4], [2, 2, 0], [3, 0, 1]]


def test_a_trial_of_middling_length_is_shown_step_by_step(reported: Path) -> None:
    rows = numbers(reported, "steps")
    assert [(row["trial"], row["verdict"]) for row in rows] == [("1000", "continue"), ("1000", "decided")]
    assert [float(row["posterior_2mm"]) for row in rows] == [0.6, 0.9]
    likelihoods = [[float(row[f"likelihood_share_{depth}mm"]) for depth in (2, 4, 8)] for row in rows]
    assert [sum(shares) for shares in likelihoods] == pytest.approx([1.0, 1.0])
    learnt = read_session(reported).primitives
    assert learnt is not None
    for row, shares in zip(rows, likelihoods, strict=True):
        ring = learnt.rings_m.tolist().index(float(row["ring_mm"]) * 1e-3)
        z = (float(row["peak_n_mm"]) * 1e-3 - learnt.mean[:, ring]) / learnt.sd[:, ring]
        assert shares.index(max(shares)) == int(np.argmin(np.abs(z)))
    words = "Trial 1000, over phantom A, the true depth 2 mm: 2 palpations, decided: 2 mm at 90 %, right"
    assert words in page_of(reported)


def test_sweeps_are_averaged_over_the_deepest_bead(reported: Path) -> None:
    stiffest = [row for row in numbers(reported, "sweeps") if row["ring_mm"] == "16"]
    mean = np.array([float(row["mean_n_mm"]) for row in stiffest])
    where = [float(row["stage_position_past_the_bead_mm"]) for row in stiffest]
    assert mean.max() == pytest.approx(16.0 * (1 + 0.1 / 8) + 0.5, abs=0.05)
    assert where[int(mean.argmax())] == pytest.approx(-30 + 14, abs=1.0)


@pytest.mark.usefixtures("blank_charts")
@pytest.mark.parametrize(
    ("what", "lacking"),
    [
        ({}, {"accuracy", "belief", "calibration", "rings", "steps"}),
        ({"repeats": 0, "trials": TRIALS}, {"primitives", "steps", "sweeps"}),
        ({"repeats": 0}, ALL),
        ({"trials": TRIALS, "swept": False}, {"steps", "sweeps"}),
        ({"trials": TRIALS, "reading": "trace"}, {"steps"}),  # a whole trace has no steps of a feature
    ],
    ids=["training alone", "no training", "nothing", "no sweeps", "whole traces"],
)
def test_a_page_has_the_charts_that_its_record_has_numbers_for(
    what: dict[str, object], lacking: set[str], record: Writer, summary: Summariser
) -> None:
    swept, reading = what.pop("swept", True), what.pop("reading", "feature")
    out = record(**what)
    if not swept:
        shutil.rmtree(out / "sweeps")
    write(out, summary(out, reading=reading))
    assert charts(out) == ALL - lacking
    assert ("no trial of estimation" in page_of(out)) == ("trials" not in what)


def laid_out(chart: Chart) -> Figure:
    """Draw a chart up to its pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    chart.draw(figure)
    figure.draw_without_rendering()
    return figure


@pytest.mark.usefixtures("blank_charts")
def test_a_single_trial_of_a_single_depth_that_stayed_undecided_is_drawn(
    record: Writer, summary: Summariser
) -> None:
    out = record(depths_m=(0.003,), repeats=1, trials=[(0, [[1.0]])], last_word="undecided")
    run = summary(out, stop="fixed_number")
    session(run)
    assert {one.name for one in charts_of(read_session(out), run) if laid_out(one).axes} == ALL - {"accuracy"}
    assert "1 undecided" in page_of(out)


def test_a_table_that_was_emptied_next_to_its_sweeps_is_not_called_kept(
    record: Writer, summary: Summariser
) -> None:
    out = record(trials=TRIALS)
    table = out / "trials.csv"
    table.write_text(table.read_text().splitlines(keepends=True)[0])
    with pytest.raises(PalpError, match=r"has no row, and .* holds \d+ sweeps: the table was emptied"):
        session(summary(out))


@pytest.mark.usefixtures("blank_charts")
def test_a_name_with_markup_does_not_reach_the_page_as_markup(record: Writer, summary: Summariser) -> None:
    described = summary(out := record(trials=TRIALS))
    described.given.append("policy:=<b>bold</b>")
    session(described)
    assert "<b>bold" not in page_of(out)
    assert "policy:=&lt;b&gt;bold" in page_of(out)


@pytest.mark.usefixtures("blank_charts")
def test_the_page_of_a_rig_with_devices_claims_no_simulation(record: Writer, summary: Summariser) -> None:
    described = summary(out := record(trials=TRIALS))
    described.params.pop("phantom")
    described.publishes.pop("phantom")
    described.params["policy"] = {"rings_mm": (0.0, 16.0)}
    session(described)
    assert "simulated" not in page_of(out)
    assert "rig with devices" in page_of(out)
    assert "0, 16" in page_of(out)


@pytest.mark.usefixtures("blank_charts")
def test_the_page_states_what_the_sweeps_met_or_that_it_was_not_recorded(
    record: Writer, summary: Summariser
) -> None:
    run = summary(out := record(trials=TRIALS))
    session(run)
    assert f"<td>A</td><td>ring_m = 0.016: {SMALL_STRAIN}</td>" in page_of(out)
    words = f"may be wrong: phantom A, ring_m = 0.016: {SMALL_STRAIN}"
    assert words in page_of(out).partition("<h2")[0]
    run.listens["experiment"].remove("/phantom/guard")
    session(run)
    assert SMALL_STRAIN not in page_of(out)
    assert "What the sweeps met was not recorded" in page_of(out)


def test_a_chart_is_the_same_bytes_every_time(rig_session: RigSession, complete: str) -> None:
    found, run = read_session(rig_session.out), read_note(rig_session.out)
    chart = next(one for one in charts_of(found, run) if one.name == "sweeps")
    assert base64.b64encode(image(chart, "svg")).decode() in complete


@pytest.mark.usefixtures("blank_charts")
def test_a_smoother_that_was_left_to_the_register_is_drawn_as_the_run_chose_it(
    record: Writer, summary: Summariser
) -> None:
    chosen = MethodSpan(node="estimator", at_s=0.0, use=used("denoise"))
    out = record(trials=TRIALS)
    write(out, summary(out, denoise=chosen.use.name), files=True)
    by_name = numbers(out, "sweeps")
    write(out, msgspec.structs.replace(summary(out, denoise="auto"), methods=[chosen]), files=True)
    assert numbers(out, "sweeps") == by_name
