"""An analysis of readings as files: a page with its charts, tables and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.counted import counted
from palp_core.palpation.readings.analysis import Analysis, Result
from palp_core.palpation.reporting import charts
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_csv
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHOWN = 4  # combinations whose reliability has a panel of its own
_NAMED = 30  # classes whose names have room beside a table of confusions

Line = dict[str, Any]


def write_analysis(analysis: Analysis, source: str, out: Path) -> Path:
    """Write analysis.json, analysis.csv, trials.csv, the charts and the page; return the page.

    Args:
        analysis: What came of it.
        source: Where the readings are from.
        out: Folder; made if missing.
    """
    out.mkdir(parents=True, exist_ok=True)
    record = {"source": source} | analysis.record
    write_json(out / "analysis.json", record)
    rows = rows_of(record)
    write_csv(out / "analysis.csv", rows[0], rows[1:])
    write_csv(
        out / "trials.csv", _TRIALS, [row for one in analysis.results for row in _trials(analysis, one)]
    )
    judged = [line for line in record["results"] if line["trials"]]
    drawn = [accuracy_chart(judged), reliability_chart(judged), progress_chart(analysis.results)]
    drawn.append(confusion_chart(judged[0], record["classes"]))
    pictures = [picture(chart, out) for chart in drawn]
    return write_page(
        out / "index.html",
        "readings.html",
        record=record,
        rows=rows,
        remarks=remarks(record),
        pictures=pictures,
    )


def rows_of(record: dict[str, Any]) -> list[list[str]]:
    """Return the results as a table of text, the heading first."""
    heads = ["policy", "likelihood", "stop", "accuracy, %", "95 %", "readings", "calibration error", "95 %"]
    return [
        [*heads, "overconfidence", "trials", "undecided", "ran out"],
        *(_row(line) for line in record["results"]),
    ]


def remarks(record: dict[str, Any]) -> list[str]:
    """Return what the results rest on, a sentence a line."""
    taught = record["training"]
    return [
        f"{counted(record['readings'], 'reading')} of {len(record['classes'])} classes at "
        f"{len(record['settings'])} "
        f"settings in {counted(record['trials'], 'trial')}, each judged by what the others taught",
        f"covariance of a cell: {taught['covariance']}; {taught['covariance_why']}",
        *(f"likelihood {one['used']}: {one['why']}" for one in taught["likelihoods"]),
        *record["notes"],
        f"intervals: {record['interval']}",
    ]


def _row(line: Line) -> list[str]:
    names = [line["policy"], line["likelihood"], line["stop"]]
    if not line["trials"]:
        return [*names, *["-"] * 6, "0", "-", "-"]
    (low, high), (least, most) = line["accuracy"]["ci"], line["calibration_error"]["ci"]
    return [
        *names,
        f"{100.0 * line['accuracy']['value']:.1f}",
        f"{100.0 * low:.1f} to {100.0 * high:.1f}",
        f"{line['readings_a_trial']:.2f}",
        f"{line['calibration_error']['value']:.3f}",
        f"{least:.3f} to {most:.3f}",
        f"{line['overconfidence']:+.3f}",
        str(line["trials"]),
        str(line["undecided"]),
        str(line["ran_out"]),
    ]


_TRIALS = (
    *("policy", "likelihood", "stop", "trial", "class", "estimate", "confidence", "right", "verdict"),
    *("readings", "settings"),
)


def _trials(analysis: Analysis, result: Result) -> list[list[Any]]:
    """Return a row per trial: what it was taken for, how sure, and after which settings."""
    of = analysis.training.readings
    return [
        [
            *(result.policy, result.likelihood, result.stop),
            of.trials[one.trial.trial_index],
            of.classes[one.trial.class_index],
            of.classes[one.estimate],
            round(one.confidence, 6),
            int(one.right),
            one.verdict,
            len(one.rows),
            " ".join(of.settings[of.setting_index[row]] for row in one.rows),
        ]
        for one in result.trials
    ]


def _label(line: Line) -> str:
    return f"{line['policy']}\n{line['likelihood']}, {line['stop']}"


def accuracy_chart(lines: Sequence[Line]) -> charts.Chart:
    """Accuracy of every combination with Wilson's interval, and how many readings it took."""

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
        at = np.arange(len(lines))[::-1]
        for place, line in zip(at, lines, strict=True):
            share = line["accuracy"]
            low, high = (100.0 * end for end in share["ci"])
            left.plot([low, high], [place, place], color=charts.BLUE, lw=1.6)
            left.plot(100.0 * share["value"], place, "o", ms=5.5, color=charts.BLUE)
        left.axvline(100.0 * lines[0]["chance"], color=charts.GREY, ls=":", lw=1.2)
        left.set_xlim(0.0, 102.0)
        left.set_yticks(at, [_label(line) for line in lines], fontsize=7.5)
        right.barh(at, [line["readings_a_trial"] for line in lines], color=charts.PALE_BLUE, height=0.55)
        charts.tidy(left, "Right; dotted: chance", "accuracy, %", "")
        charts.tidy(right, "Readings a trial", "mean number", "")

    return charts.Chart(
        "accuracy",
        "Accuracy",
        "Share of trials whose last estimate was the true class, whatever the verdict, with Wilson's 95 % "
        "interval over trials. Each trial was judged by what the others taught.",
        1.2 + 0.45 * len(lines),
        ("policy", "likelihood", "stop", "right", "trials", "accuracy", "low", "high", "readings"),
        [
            (
                *(line["policy"], line["likelihood"], line["stop"]),
                *(line["accuracy"]["right"], line["accuracy"]["of"], line["accuracy"]["value"]),
                *line["accuracy"]["ci"],
                line["readings_a_trial"],
            )
            for line in lines
        ],
        draw,
    )


def reliability_chart(lines: Sequence[Line]) -> charts.Chart:
    """Stated probability against accuracy, a panel for each of the first combinations."""
    shown = lines[:_SHOWN]

    def panel(axes: Axes, line: Line) -> None:
        axes.plot([0, 100], [0, 100], color=charts.GREY, ls="--", lw=1.2)
        for one in line["reliability"]:
            share = one["accuracy"]
            x, y = 100.0 * one["stated"], 100.0 * share["value"]
            reach = [[y - 100.0 * share["ci"][0]], [100.0 * share["ci"][1] - y]]
            axes.errorbar(x, y, yerr=reach, fmt="o", ms=5, capsize=3, color=charts.BLUE)
            axes.annotate(
                str(share["of"]),
                (x, 100.0 * share["ci"][1]),
                xytext=(0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=7,
            )
        axes.set_xlim(0.0, 105.0)
        axes.set_ylim(-4.0, 112.0)
        title = f"{line['policy']}, {line['likelihood']}: {100.0 * line['calibration_error']['value']:.1f} %"
        charts.tidy(axes, title, "stated probability, %", "accuracy, %")

    def draw(figure: Figure) -> None:
        columns = min(len(shown), 2)
        panels = np.ravel(figure.subplots(-(-len(shown) // columns), columns, squeeze=False))
        for axes, line in zip(panels, shown, strict=False):
            panel(axes, line)
        for axes in panels[len(shown) :]:
            axes.set_visible(False)

    return charts.Chart(
        "reliability",
        "Reliability",
        "How often estimates of a stated probability were right, in bins of 10 %, with Wilson's 95 % "
        "interval and the number of trials above; on the dashed line confidence is deserved. In the title: "
        "expected calibration error. Readings of a trial are taken for independent: errors that stay in a "
        "trial make the belief over-confident.",
        3.6 * -(-len(shown) // 2),
        (
            "policy",
            "likelihood",
            "stop",
            "bin_low",
            "bin_high",
            "stated",
            "accuracy",
            "low",
            "high",
            "trials",
        ),
        [
            (
                *(line["policy"], line["likelihood"], line["stop"], one["low"], one["high"], one["stated"]),
                *(one["accuracy"]["value"], *one["accuracy"]["ci"], one["accuracy"]["of"]),
            )
            for line in lines
            for one in line["reliability"]
        ],
        draw,
    )


def progress_chart(results: Sequence[Result]) -> charts.Chart:
    """Accuracy after 1, 2, ... readings; a trial that has ended keeps its estimate."""
    curves = {(one.policy, one.likelihood, one.stop): _progress(one) for one in results if one.trials}

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for number, (names, curve) in enumerate(curves.items()):
            style = charts.depth_style(number)
            at = np.arange(1, len(curve) + 1)
            axes.plot(at, 100.0 * curve, ms=3.5, label=", ".join(names), **style)
        axes.set_ylim(0.0, 102.0)
        axes.locator_params(axis="x", integer=True)
        charts.legend(axes, fontsize=7.5)
        charts.tidy(axes, "", "readings", "right, %")

    return charts.Chart(
        "progress",
        "Accuracy over readings",
        "Share of trials whose estimate after so many readings is right. A trial that has stopped or run out "
        "keeps its last estimate.",
        3.4,
        ("policy", "likelihood", "stop", "readings", "accuracy"),
        [(*names, n + 1, float(share)) for names, curve in curves.items() for n, share in enumerate(curve)],
        draw,
    )


def _progress(result: Result) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    longest = max(len(one.right_after) for one in result.trials)
    carried = [[*one.right_after, *[one.right] * (longest - len(one.right_after))] for one in result.trials]
    return np.asarray(np.mean(np.array(carried, dtype=np.float64), axis=0))


def confusion_chart(line: Line, classes: Sequence[str]) -> charts.Chart:
    """What each class was taken for, of the first combination."""
    counts = np.array(line["confusion"])
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        shown = axes.imshow(100.0 * share, vmin=0.0, vmax=100.0, cmap="cividis")
        axes.grid(visible=False)
        if len(classes) <= _NAMED:
            axes.set_xticks(range(len(classes)), classes, rotation=45, ha="right", fontsize=7.5)
            axes.set_yticks(range(len(classes)), classes, fontsize=7.5)
        figure.colorbar(shown, ax=axes, shrink=0.8).set_label("share of the class, %")
        charts.tidy(axes, "", "taken for", "class")

    side = min(4.0 + 0.16 * len(classes), 7.0)
    return charts.Chart(
        "confusion",
        "What is taken for what",
        f"Of the first combination: {line['policy']}, {line['likelihood']}, {line['stop']}.",
        side,
        ("class", *(f"taken_for_{name}" for name in classes)),
        [(name, *map(int, row)) for name, row in zip(classes, counts, strict=True)],
        draw,
    )
