from __future__ import annotations

import base64
import csv
import dataclasses
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import MethodSpan
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.reporting.charts import Chart, image, save
from palp_core.palpation.session import report_page
from palp_core.palpation.session.charts.of_session import charts_of
from palp_core.palpation.session.charts.rig import rig_chart
from palp_core.palpation.session.charts.training import primitives_chart
from palp_core.palpation.session.methods.used import used
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.report import session, write
from palp_core.palpation.session.result import read_result
from palp_core.palpation.session.result_json import build
from palp_core.palpation.session.run_note import read_note
from tests.support.rig_session import RigSession
from tests.support.sessions import SMALL_STRAIN, charts_in, describe, no_charts, writer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Writer = Callable[..., Path]
Summariser = Callable[..., RunSummary]

TRIALS = [
    (0, [[0.6, 0.3, 0.1], [0.9, 0.1, 0.0]]),
    (0, [[0.8, 0.1, 0.1]]),
    (1, [[0.2, 0.6, 0.2]]),
    (2, [[0.1, 0.6, 0.3], [0.1, 0.7, 0.2], [0.1, 0.8, 0.1]]),
]
ALL = {"accuracy", "belief", "calibration", "primitives", "rig", "rings", "steps", "sweeps"}


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a session with its report, for tests that only read it; its charts are blank."""
    out = writer(tmp_path_factory.mktemp("reported"))(trials=TRIALS)
    with no_charts():
        write(out, describe(out), files=True)
    return out


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
    assert "palp session report /" in (out / "report.html").read_text(encoding="utf-8")
    assert set(re.findall(r'data-name="(\w+)"', complete)) == ALL
    assert not (out / "charts").exists()
    assert not list(out.rglob("*.part"))


@pytest.fixture(scope="module")
def complete(rig_session: RigSession, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the page of a session with all its charts."""
    out = tmp_path_factory.mktemp("complete") / "out"
    shutil.copytree(rig_session.out, out)
    write(out, read_note(out))
    return (out / "report.html").read_text(encoding="utf-8")


def test_files_of_the_charts_are_made_where_they_are_asked_for(reported: Path) -> None:
    names = {path.name for path in (reported / "charts").iterdir()}
    assert names == {f"{name}.{form}" for name in ALL - {"accuracy"} for form in ("png", "svg", "csv")}
    assert "charts/belief.csv" in (reported / "report.html").read_text(encoding="utf-8")


def test_the_page_needs_no_other_file(complete: str) -> None:
    page = complete
    pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', page)
    assert len(pictures) == len(ALL) - 1  # accuracies are drawn by the page itself
    assert all(b"<svg" in base64.b64decode(one) for one in pictures)
    assert len(page) < 2_000_000
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "http" not in re.sub(r"base64,[^\"]+", "", page)


class _Balance(HTMLParser):
    """Keeps the tags that are open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_every_tag_of_the_page_is_closed(reported: Path) -> None:
    reader = _Balance()
    reader.feed((reported / "report.html").read_text(encoding="utf-8"))
    assert reader.open == []


@pytest.mark.usefixtures("blank_charts")
def test_the_page_states_the_session_and_the_reach_of_its_intervals(
    record: Writer, summary: Summariser
) -> None:
    said = session(summary(out := record(trials=TRIALS)))
    page = (out / "report.html").read_text(encoding="utf-8")
    assert said.splitlines()[0] in page
    assert said.endswith(f"Report: {out / 'report.html'}")
    assert "found the right depth in 3 of 4 trials: 75.0 %" in page
    assert "speak for this session only" in page
    assert "slightly above 90 %" in page
    assert "eigenvalues published, entries not legible" in page


def test_a_trial_that_has_ended_keeps_its_last_belief(reported: Path) -> None:
    at_2mm = [row for row in numbers(reported, "belief") if row["depth_mm"] == "2"]
    assert [int(row["trials_running"]) for row in at_2mm] == [2, 2, 1, 0]
    second = 0.8 * 2 + 0.1 * 4 + 0.1 * 8
    expected = [14 / 3, (0.6 * 2 + 0.3 * 4 + 0.1 * 8 + second) / 2, *2 * [(0.9 * 2 + 0.1 * 4 + second) / 2]]
    assert [float(row["expected_depth_mm"]) for row in at_2mm] == pytest.approx(expected)


def test_ring_positions_are_counted_by_iteration(reported: Path) -> None:
    counts = [list(map(int, row.values())) for row in numbers(reported, "rings")]
    assert counts == [[1, 0, 4], [2, 2, 0], [3, 0, 1]]


def test_a_trial_of_middling_length_is_told_step_by_step(reported: Path) -> None:
    rows = numbers(reported, "steps")
    assert [row["trial"] for row in rows] == ["1000"] * 2  # of 2, 1, 1 and 3 palpations
    assert [row["verdict"] for row in rows] == ["continue", "decided"]
    assert [float(row["posterior_2mm"]) for row in rows] == [0.6, 0.9]
    likelihoods = [[float(row[f"likelihood_share_{depth}mm"]) for depth in (2, 4, 8)] for row in rows]
    assert [sum(shares) for shares in likelihoods] == pytest.approx([1.0, 1.0])
    learnt = read_session(reported).primitives
    assert learnt is not None
    read = [float(row["peak_n_mm"]) * 1e-3 for row in rows]
    rings = [learnt.rings_m.tolist().index(float(row["ring_mm"]) * 1e-3) for row in rows]
    z = [(value - learnt.mean[:, k]) / learnt.sd[:, k] for value, k in zip(read, rings, strict=True)]
    assert [shares.index(max(shares)) for shares in likelihoods] == [int(np.argmin(np.abs(one))) for one in z]
    page = (reported / "report.html").read_text(encoding="utf-8")
    assert (
        "Trial 1000, over phantom A, the true depth 2 mm: 2 palpations, decided: 2 mm at 90 %, right" in page
    )


@pytest.mark.usefixtures("blank_charts")
def test_a_trial_decided_by_the_whole_trace_has_no_steps_of_a_feature(
    record: Writer, summary: Summariser
) -> None:
    write(out := record(trials=TRIALS), summary(out, reading="trace"))
    assert charts(out) == ALL - {"steps"}


def test_the_rig_is_drawn_to_scale_with_its_labels(reported: Path) -> None:
    sizes = {(row["of"], row["quantity"]): float(row["mm"]) for row in numbers(reported, "rig")}
    assert sizes["probe", "base_m"] == 80.0
    assert [sizes[code, "depth_m"] for code in "ABC"] == [2.0, 4.0, 8.0]
    assert sizes["stage", "indentation_m"] == 4.0
    mechanics = read_result(reported).mechanics
    assert mechanics is not None
    figure = laid_out(rig_chart(mechanics.scene, rings_m=(0.0, 0.016), indentation_m=0.004))
    drawn = {text.get_text() for axes in figure.axes for text in axes.texts}
    for words in ("torque sensor", "base link, 80 mm", "joint, R = 6.8 mm", "tip link, 70 mm", "bead, 15 mm"):
        assert words in drawn
    (x0, y0), (x1, y1) = figure.axes[0].transData.transform([(0.0, 0.0), (1.0, 1.0)])
    assert x1 - x0 == pytest.approx(y1 - y0)


def laid_out(chart: Chart) -> Figure:
    """Draw a chart up to its pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    chart.draw(figure)
    figure.draw_without_rendering()
    return figure


def test_the_page_begins_with_versions_and_the_command_and_has_every_trial(reported: Path) -> None:
    page = (reported / "report.html").read_text(encoding="utf-8")
    top, _, rest = page.partition("<h2")
    assert f"palp launch launch/sim.yaml out:={reported} trials:=2 training:=2<" in top
    assert "numpy " in top
    table = rest[rest.index("Every trial") :]
    cells = "<td>1003</td><td>C</td><td>8 mm</td><td>3</td><td>16, 0, 16</td><td>4 mm</td><td>wrong</td>"
    assert cells in table
    assert table.count("<td>decided</td>") == len(TRIALS)


def test_sweeps_are_averaged_over_the_deepest_bead(reported: Path) -> None:
    rows = numbers(reported, "sweeps")
    stiffest = [row for row in rows if row["ring_mm"] == "16"]
    mean = np.array([float(row["mean_n_mm"]) for row in stiffest])
    where = [float(row["stage_position_past_the_bead_mm"]) for row in stiffest]
    assert mean.max() == pytest.approx(16.0 * (1 + 0.1 / 8) + 0.5, abs=0.05)
    assert where[int(mean.argmax())] == pytest.approx(-30 + 14, abs=1.0)


@pytest.mark.usefixtures("blank_charts")
def test_a_session_of_training_alone_shows_what_was_learnt(record: Writer, summary: Summariser) -> None:
    write(out := record(), summary(out))
    assert charts(out) == {"primitives", "rig", "sweeps"}
    assert "no trial of estimation" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("blank_charts")
def test_a_session_without_training_shows_its_trials(record: Writer, summary: Summariser) -> None:
    write(out := record(repeats=0, trials=TRIALS), summary(out))
    assert charts(out) == {"accuracy", "belief", "calibration", "rig", "rings"}


def test_a_session_of_nothing_has_a_page_too(record: Writer, summary: Summariser) -> None:
    session(summary(out := record(repeats=0)))
    assert charts(out) == set()
    assert "0 palpations were recorded" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("blank_charts")
def test_a_single_trial_of_a_single_depth_that_stayed_undecided_is_drawn(
    record: Writer, summary: Summariser
) -> None:
    out = record(depths_m=(0.003,), repeats=1, trials=[(0, [[1.0]])], last_word="undecided")
    session(summary(out, stop="fixed_number"))
    run, found = summary(out, stop="fixed_number"), read_session(out)
    drawn = {one.name for one in charts_of(found, run, build(found, run)) if laid_out(one).axes}
    assert drawn == ALL - {"accuracy"}
    assert "1 undecided" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("blank_charts")
def test_a_record_cut_short_within_a_trial_leaves_that_trial_out(record: Writer, summary: Summariser) -> None:
    out = record(trials=TRIALS)
    table = out / "trials.csv"
    table.write_text(table.read_text()[:-20])
    session(summary(out))
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "in 3 of 3 trials" in page
    assert "does not see end: 1, left out" in page


@pytest.mark.usefixtures("blank_charts")
def test_without_its_sweeps_a_record_still_has_a_report(record: Writer, summary: Summariser) -> None:
    out = record(trials=TRIALS)
    shutil.rmtree(out / "sweeps")
    write(out, summary(out))
    assert charts(out) == ALL - {"steps", "sweeps"}


def test_a_table_that_was_emptied_beside_its_sweeps_is_not_called_kept(
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
    described.args["policy"] = "<b>bold</b>"
    session(described)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<b>bold" not in page
    assert "&lt;b&gt;bold" in page


@pytest.mark.usefixtures("blank_charts")
def test_the_page_of_a_rig_with_devices_claims_no_simulation(record: Writer, summary: Summariser) -> None:
    described = summary(out := record(trials=TRIALS))
    described.params.pop("phantom")
    described.publishes.pop("phantom")
    described.params["policy"] = {"rings_mm": (0.0, 16.0)}
    session(described)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "simulated" not in page
    assert "rig with devices" in page
    assert "0, 16" in page


@pytest.mark.usefixtures("blank_charts")
def test_the_page_states_what_the_sweeps_met_or_that_nobody_told(record: Writer, summary: Summariser) -> None:
    run = summary(out := record(trials=TRIALS))
    session(run)
    page = (out / "report.html").read_text("utf-8")
    assert f"<td>A</td><td>ring_m = 0.016: {SMALL_STRAIN}</td>" in page
    assert f"may be wrong: phantom A, ring_m = 0.016: {SMALL_STRAIN}" in page.partition("<h2")[0]
    run.listens["experiment"].remove("/phantom/guard")
    session(run)
    page = (out / "report.html").read_text("utf-8")
    assert SMALL_STRAIN not in page
    assert "What the sweeps met was not recorded" in page


def test_any_number_of_ring_positions_finds_a_panel(record: Writer, tmp_path: Path) -> None:
    found = read_session(record(repeats=0))
    shape = (3, 5)
    learnt = Primitives(
        depths_m=np.array([0.002, 0.004, 0.008]),
        rings_m=np.linspace(0.0, 0.016, 5),
        mean=np.ones(shape) * 0.01,
        sd=np.full(shape, 1e-4),
        count=np.arange(1.0, 16.0).reshape(shape),
        floor=1e-5,
    )
    chart = primitives_chart(dataclasses.replace(found, primitives=learnt))
    assert chart is not None
    assert len(chart.rows) == 15
    assert "1 to 15 palpations" in chart.caption
    save(chart, tmp_path)
    assert (tmp_path / "primitives.png").read_bytes().startswith(b"\x89PNG")


def test_a_chart_is_the_same_bytes_every_time(rig_session: RigSession, complete: str) -> None:
    found, run = read_session(rig_session.out), read_note(rig_session.out)
    chart = next(one for one in charts_of(found, run, build(found, run)) if one.name == "sweeps")
    assert base64.b64encode(image(chart, "svg")).decode() in complete
    assert image(chart, "png") == image(chart, "png")


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


@pytest.mark.parametrize(
    ("device", "link", "touch", "said"),
    [
        ("sim", None, True, "simulated rig"),
        ("aerotech", "socket://10.0.0.1:8001", True, "emulated devices, simulated phantoms"),
        ("aerotech", "socket://10.0.0.1:8001", False, "rig with devices"),
        ("newport", "none", False, "rig with devices, without a link of the safety node's own to the stage"),
        ("newport", "none", True, "simulated phantoms, without a link of the safety node's own to the stage"),
    ],
)
def test_the_page_says_what_was_swept_and_repeats_that_the_stage_had_no_link_for_stopping(
    device: str, link: str | None, touch: bool, said: str, record: Writer, summary: Summariser
) -> None:
    run = summary(out := record())
    run.params["stage"] = {"device": device}
    if link is not None:
        run.params["safety"] = {"stop_link": link}
    if not touch:
        run.publishes["phantom"].pop("/phantom/guard")
    words = report_page._rig(build(read_session(out), run))
    assert said in words
    assert ("(stop_link: none)" in words) == (link == "none")
