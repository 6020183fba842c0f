"""What the page of the study ``robustness`` says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palp_core.palpation.reporting.html_page import paragraph, table
from palp_core.palpation.studies.robustness.claim import CHANGES, LEVEL

_ALL_BITS = float(np.log2(3.0))
_SATURATED = 0.02  # bits below what three depths hold
_SHOWN = (
    "fixed_0",
    "fixed_average",
    "fixed_best",
    "markov",
    "uniform",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)


def reasons(
    row: Mapping[str, Any], changed: Sequence[Mapping[str, Any]], promised: Mapping[str, Mapping[str, float]]
) -> list[str]:
    """Return why information gain is worse in a cell.

    Args:
        row: Its comparison with the best of the others.
        changed: The same comparison, with one thing changed each.
        promised: What it is promised by each ring position, as of
            :func:`~palp_core.palpation.studies.robustness.jobs.promises`.
    """
    by_name = {one.name: one for one in CHANGES}
    found = [
        f"{by_name[one['change']].reason} ({_points(one)} instead of {_points(row)})"
        for one in changed
        if one["ci"][1] >= 0.0 and one["difference"] > 0.5 * row["difference"]
    ]
    full = [ring for ring, one in promised.items() if one["bits"] > _ALL_BITS - _SATURATED]
    if len(full) > 1:
        found.append(
            f"its promise is full: by its model one reading tells all {_ALL_BITS:.2f} bits at "
            f"{', '.join(full)} mm alike, so it does not see which position errs least"
        )
    return found or [
        "none of the changes alone takes it away: what is left is that it looks one probe ahead, and takes "
        "readings to answer in straight lines to landing and height"
    ]


def _points(row: Mapping[str, Any]) -> str:
    return f"{100 * row['difference']:+.1f} points, {100 * row['ci'][0]:+.1f} to {100 * row['ci'][1]:+.1f}"


def page_parts(report: Mapping[str, Any], pictures: Sequence[str]) -> list[str]:
    """Return the page's parts, the pictures among them."""
    return [
        _lead(report),
        *_how(report),
        *_answers(report),
        _worse(report["worse"]),
        *pictures,
        _family(report["family"]),
        _cells(report["cells"]),
    ]


def _lead(report: Mapping[str, Any]) -> str:
    words = [
        f"{claim['policy'].replace('_', ' ')} ({claim['design']} design) in "
        f"{sum(row['worse'] for row in claim['cells'])} of {len(claim['cells'])}"
        for claim in report["claims"]
    ]
    return paragraph(
        "Is information gain ever significantly worse than the best of the others? Cells where it is: "
        f"{'; '.join(words)} (Holm over the cells).",
        "lead",
    )


def _how(report: Mapping[str, Any]) -> list[str]:
    return [
        paragraph(
            f"{report['sessions']} sessions a cell, each with its own training and mountings, "
            f"{report['trials']} trials of each depth; all cells and policies share their luck. Intervals "
            "are over sessions. In the paper design readings are taken for independent and the correlation "
            "distance stops a trial; in the aware design the filter knows what stays (landing, height, "
            "errors of training) and a trial ends at a posterior of 0.95."
        ),
        paragraph(
            "The best of the others is chosen anew for each session by all other sessions, because the "
            "largest of a dozen noisy means is too large. A suspected cell is one whose own interval lies "
            "below 0 though it is not significant among all: of 40 cells one does so by chance."
        ),
        *_too_few(int(report["sessions"]), len(report["cells"])),
    ]


def _too_few(sessions: int, cells: int) -> list[str]:
    """Return a caution where no cell could be significant, whatever was found."""
    least = 2.0 ** (1 - sessions) * cells
    if least < LEVEL:
        return []
    return [
        paragraph(
            f"With {sessions} sessions the least p that signs can give is {2.0 ** (1 - sessions):.2g}, and "
            f"{min(least, 1.0):.2g} among {cells} cells: no cell can be significant here, and that none is "
            "says nothing. Run without --quick."
        )
    ]


def _answers(report: Mapping[str, Any]) -> list[str]:
    parts = []
    for claim in report["claims"]:
        rows = claim["cells"]
        least = min(rows, key=lambda row: float(row["difference"]))
        better = sum(row["ci"][0] > 0.0 for row in rows)
        widest = max(0.5 * (row["ci"][1] - row["ci"][0]) for row in rows)
        parts.append(
            paragraph(
                f"{claim['policy'].replace('_', ' ')}, {claim['design']} design: interval above 0 in "
                f"{better} cells, below in {sum(row['suspected'] for row in rows)}; least in {least['cell']} "
                f"({_points(least)}, against {least['best'].replace('_', ' ')}). Half an interval is at most "
                f"{100 * widest:.1f} points: less cannot be seen with these sessions."
            )
        )
    return parts


def _worse(rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return "<h2>Where information gain is worse, and why</h2>" + paragraph("In no cell.")
    return "<h2>Where information gain is worse, and why</h2>" + table(
        ["cell", "policy and design", "against", "difference", "Holm's p", "why"],
        [
            [
                row["cell"],
                f"{row['policy'].replace('_', ' ')}, {row['design']}",
                row["best"].replace("_", " "),
                _points(row),
                f"{row['p_holm']:.3g}" + ("" if row["worse"] else " (suspected)"),
                "; ".join(row["why"]),
            ]
            for row in rows
        ],
    )


def _family(family: Mapping[str, Any]) -> str:
    rows = [
        [
            f"minus {name.replace('_', ' ')}",
            *(f"{100 * band[k]:+.1f}" for k in _BAND),
            f"{band['above_0']:.2f}",
        ]
        for name, band in family["minus"].items()
    ]
    band = family["band"]
    head = ["human strategy", "2.5 %", "median", "97.5 %", "least", "most", "share above 0"]
    return "<h2>The human strategy over its family, percentage points</h2>" + table(
        head, [["accuracy", *(f"{100 * band[k]:.1f}" for k in _BAND), ""], *rows]
    )


_BAND = ("low", "median", "high", "least", "most")


def _cells(cells: Sequence[Mapping[str, Any]]) -> str:
    def share(line: Mapping[str, Any]) -> str:
        low, high = line["accuracy_ci"]
        return f"{100 * line['accuracy']:.1f} ({100 * low:.1f} to {100 * high:.1f})"

    return "<h2>Every cell: accuracy in %, the paper's filter and stop rule</h2>" + table(
        ["cell", *(name.replace("_", " ") for name in _SHOWN)],
        [[cell["name"], *(share(cell["designs"]["paper"][name]) for name in _SHOWN)] for cell in cells],
    )
