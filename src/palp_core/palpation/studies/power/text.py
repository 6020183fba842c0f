"""What the page of the study ``power`` says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from palp_core.palpation.reporting.html_page import paragraph, table


def page_parts(report: Mapping[str, Any], pictures: Sequence[str]) -> list[str]:
    """Return the page's parts, the pictures among them."""
    return [
        _lead(report),
        _how(report),
        _policies(report),
        _needed(report),
        *pictures,
        _paper(report),
        _human(report),
    ]


def _lead(report: Mapping[str, Any]) -> str:
    paper = report["paper"]
    independent, one = (paper["detectable"][name]["80"] for name in list(paper["detectable"])[:2])
    fixed = report["policies"]["fixed_average"]
    return paragraph(
        f"300 trials of one session are worth {fixed['worth_of_300']:.0f} independent ones (average over "
        f"fixed positions; correlation within a session {fixed['intraclass']:.3f}). 300 independent trials "
        f"of each strategy tell {_percent(independent)} from 66.7 % with a power of 80 %; 300 of one session "
        f"each {_percent(one)}. A test that takes them for independent finds a difference between a strategy "
        f"and itself in {100 * fixed['false_alarms_of_300']:.0f} % of pairs of sessions, not in 5 %.",
        "lead",
    )


def _how(report: Mapping[str, Any]) -> str:
    return paragraph(
        f"The pool: {report['pool']} sessions of the paper's design, {report['pool_trials']} trials of each "
        f"depth in each. An experiment draws sessions from it and trials from each session; every policy "
        f"meets the session's training and mountings, its trials are its own. {report['repeats']} "
        "experiments a point, tested by Student's paired test over sessions, two-sided at 0.05; Holm over "
        "the four comparisons where it says so. A session on a real rig varies as its gel, mountings and "
        "training do: measure them (plan repeatability) before trusting a number of sessions from here."
    )


def _policies(report: Mapping[str, Any]) -> str:
    rows = [
        [
            name.replace("_", " "),
            f"{100 * line['share']:.1f} %",
            f"{100 * line['session_sd']:.1f}",
            f"{line['intraclass']:.3f}",
            f"{line['design_effect_300']:.1f}",
            f"{line['worth_of_300']:.0f}",
            f"{100 * line['false_alarms_of_300']:.0f} %",
        ]
        for name, line in report["policies"].items()
    ]
    head = ["policy", "accuracy", "sd over sessions, points", "correlation", "design effect of 300"]
    more = ["300 are worth", "false alarms of two proportions"]
    return "<h2>How alike trials of a session are</h2>" + table([*head, *more], rows)


def _needed(report: Mapping[str, Any]) -> str:
    differences = {f"{one['first']} - {one['second']}": one for one in report["differences"]}
    most = max(point["sessions"] for point in report["curves"])
    rows = []
    for line in report["needed"]:
        apart = differences[line["comparison"]]
        low, high = (100 * x for x in apart["ci"])
        rows.append(
            [
                line["comparison"].replace("_", " ").replace(" - ", " − "),
                f"{100 * apart['difference']:+.1f} ({low:+.1f} to {high:+.1f})",
                str(line["trials"]),
                *(
                    _count(line[key], most)
                    for key in ("power_80", "power_90", "power_holm_80", "power_holm_90")
                ),
            ]
        )
    return "<h2>Sessions needed for our differences</h2>" + table(
        ["comparison", "points", "trials per depth", "80 %", "90 %", "80 %, Holm", "90 %, Holm"], rows
    )


def _paper(report: Mapping[str, Any]) -> str:
    paper = report["paper"]
    most = max(paper["sessions"])
    return (
        "<h2>The published 90 against 66.7 %</h2>"
        + paragraph(
            "Sessions of each strategy, its own for each, with the correlations measured here (sessions "
            "follow a beta law), tested by Welch's test over sessions."
        )
        + table(
            ["trials per depth", "80 %", "90 %"],
            [
                [each, *(_count(line[w], most) for w in ("80", "90"))]
                for each, line in paper["needed"].items()
            ],
        )
        + paragraph("The least share that 300 trials of each strategy tell from 66.7 %:")
        + table(
            ["the 300 trials are", "80 %", "90 %"],
            [
                [name, *(_percent(line[w]) for w in ("80", "90"))]
                for name, line in paper["detectable"].items()
            ],
        )
    )


def _human(report: Mapping[str, Any]) -> str:
    human = report["human"]
    most = max(human["subjects"])
    return (
        "<h2>Subjects</h2>"
        + paragraph(
            "The human experiment had 6 subjects with 5 trials a depth: 80 % at 2 mm, 56.7 % at 4 and 8 mm. "
            "How alike a subject's trials are was not published, so it is varied. Power: 2 mm against the "
            "mean of the others, paired over subjects; and the least share that another group of 6 "
            f"subjects would need to be told from {100 * human['share']:.1f} % with 80 %."
        )
        + table(
            [
                "correlation (assumed)",
                "power of 6",
                "subjects for 80 %",
                "for 90 %",
                "least share told apart",
            ],
            [
                [
                    rho,
                    f"{100 * powers[0]:.0f} %",
                    *(_count(human["needed"][rho][w], most) for w in ("80", "90")),
                    _percent(human["detectable_by_intraclass"][rho]),
                ]
                for rho, powers in human["power_by_intraclass"].items()
            ],
        )
    )


def _count(found: int | None, most: int) -> str:
    return f"more than {most}" if found is None else str(found)


def _percent(share: float | None) -> str:
    return "not even 100 %" if share is None else f"{100 * share:.1f} %"
