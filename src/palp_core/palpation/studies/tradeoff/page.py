"""The page of a survey with what is beside it: charts as PNG, SVG and CSV, and all numbers for machines."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import math
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palp_core import __version__
from palp_core.methods.choice import amount, percent, seconds
from palp_core.methods.machine import UNIT_S, unit_s
from palp_core.methods.measured import Measured
from palp_core.palpation.reporting.html_page import Picture, picture, write_page
from palp_core.palpation.studies.contact.case import FailureCase
from palp_core.palpation.studies.tradeoff.chart import KEY, chart_name, task_chart
from palp_core.palpation.studies.tradeoff.judge import Judgement, panels
from palp_core.palpation.studies.tradeoff.source import method_digest
from palp_core.palpation.studies.tradeoff.survey import Survey, TaskSurvey
from palp_core.whole_file import write_json

STUDIES = {
    "contact-stability": "where contact, root finders, friction and elements fail, with every threshold",
    "contact-validity": "whether stated bounds are kept on random scenes",
    "decision-stability": "every trap of the published algorithm, the naive way and ours",
}
"""Evidence that the page names: a study each, of minutes."""


@dataclass(frozen=True)
class TaskSection:
    """What a page says of a task.

    Attributes:
        survey: The task and what was measured.
        picture: Its chart; None where nothing was measured.
        head: Names of the table's columns.
        rows: The table, a row per method and setting.
        cases: Where methods fail: method, symptom, where, survivor.
    """

    survey: TaskSurvey
    picture: Picture | None
    head: Sequence[str]
    rows: Sequence[tuple[Sequence[str], str]]
    cases: Sequence[Sequence[str]]


def write_tradeoff(survey: Survey, out: Path) -> Path:
    """Write page, charts, tables and ``tradeoff.json``; return the page.

    Args:
        survey: What was measured.
        out: Folder for the files; made if missing.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "tradeoff.json", record(survey))
    sections = [_section(one, out) for one in survey.tasks]
    return write_page(
        out / "index.html",
        "tradeoff.html",
        survey=survey,
        sections=sections,
        scene=scene_words(survey),
        key=KEY,
        slowness=unit_s() / UNIT_S,
        unit_ms=1e3 * unit_s(),
        studies=STUDIES,
    )


def scene_words(survey: Survey) -> str:
    """Return the scene in a line."""
    scene = survey.scene
    phantom, path, asked = scene.phantom, scene.path, scene.tolerance
    bead = phantom.bead
    over = f"a bead of {bead.radius_m * 1e3:g} mm, {bead.depth_m * 1e3:g} mm deep in " if bead else ""
    rings = ", ".join(f"{ring_m * 1e3:g}" for ring_m in scene.ring_m)
    return (
        f"a ball of {scene.probe.tip_radius_m * 1e3:g} mm over {over}{phantom.height_m * 1e3:g} mm of gel of "
        f"{phantom.modulus_pa * 1e-3:g} kPa, pressed {path.indentation_m * 1e3:g} mm at "
        f"{path.speed_m_s * 1e3:g} mm/s, r_a = {rings} mm; {asked.output} within {percent(asked.relative)}"
    )


def _section(one: TaskSurvey, out: Path) -> TaskSection:
    drawn = picture(task_chart(one.choice, one.points), out) if one.points else None
    if drawn is None:
        for kind in ("png", "svg", "csv"):  # of an earlier survey: beside this page they would be its own
            (out / f"{chart_name(one.choice)}.{kind}").unlink(missing_ok=True)
    head = ("method", "setting", "cost", "error", "bound", "mark", "evidence", "fails", "survivor")
    return TaskSection(one, drawn, head, task_rows(one), [_case(case) for case in one.cases])


def task_rows(one: TaskSurvey) -> list[tuple[Sequence[str], str]]:
    """Return a row per point of the output that is asked for, by method; one for what was not measured.

    Each row has its cells (method, setting, cost, error, bound, mark, evidence, where it fails, survivor) and
    its kind: ``total`` of the chosen method, ``bad`` where it fails.
    """
    measured: dict[str, list[Judgement]] = {}
    every = panels(one.choice, one.points)
    for found in (mark for panel in every if panel.output == every[0].output for mark in panel.found):
        measured.setdefault(found.point.method, []).append(found)
    rows: list[tuple[Sequence[str], str]] = []
    for method, offer in one.choice.declared():
        bound = "-" if offer.bound is None else amount(offer.bound, one.choice.output)
        fails, survivor = method.fails or "-", method.survivor or "-"
        tail = (bound, offer.mark, method.evidence)
        if method.name not in measured:
            rows.append(((method.name, "", "not measured", "", *tail, fails, survivor), ""))
        for found in measured.get(method.name, []):
            point = found.point
            setting = ", ".join(part for part in (point.setting, point.condition) if part)
            kind = "total" if found.chosen else "bad" if point.fails else ""
            here = point.fails or fails
            cells = (method.name, setting, seconds(point.cost_s), _error(point), *tail, here, survivor)
            rows.append((cells, kind))
    return rows


def _case(case: FailureCase) -> Sequence[str]:
    return case.row


def _error(point: Measured) -> str:
    error = point.error
    if math.isnan(error):
        return "no answer"
    if math.isinf(error):
        return "without bound"
    return f"{error:.3g} times" if error >= 10.0 else amount(error, point.output)


def record(survey: Survey) -> dict[str, Any]:
    """Return all that was measured, and with what, as plain values; NaN and infinity as null."""
    return {
        **made_with(),
        "scene": dataclasses.asdict(survey.scene),
        "budget_s": survey.budget_s,
        "took_s": survey.took_s,
        "ended": survey.ended,
        "tasks": [_task_record(one) for one in survey.tasks],
    }


def made_with() -> dict[str, Any]:
    """Return versions and the machine's unit, CPU s."""
    versions = {name: importlib.metadata.version(name) for name in ("numpy", "scipy")}
    return {
        "versions": {"palp": __version__, "python": platform.python_version(), **versions},
        "machine": {"unit_s": unit_s(), "declared_unit_s": UNIT_S, "processor": platform.machine()},
    }


def _task_record(one: TaskSurvey) -> dict[str, Any]:
    choice = one.choice
    found = [mark for panel in panels(choice, one.points) for mark in panel.found]
    return {
        "task": choice.task.name,
        "per": choice.task.per,
        "output": choice.output,
        "tolerance": choice.tolerance,
        "chosen": choice.chosen.name if choice.chosen else None,
        "missing": one.missing,
        "took_s": one.took_s,
        "methods": [
            {
                "name": method.name,
                "mark": offer.mark,
                "why": offer.why,
                "bound": offer.bound,
                "cost_s": method.cost_s,
                "evidence": method.evidence,
                "fails": method.fails,
                "survivor": method.survivor,
                "digest": method_digest(method),
            }
            for method, offer in choice.declared()
        ],
        "points": [point_record(mark) for mark in found],
        "cases": [
            dict(zip(("failing", "symptom", "fails_at", "survivor"), c.row, strict=True)) for c in one.cases
        ],
    }


def point_record(one: Judgement) -> dict[str, Any]:
    """Return a point and what it is, as plain values."""
    point = dataclasses.asdict(one.point)
    error = one.point.error
    return point | {
        "error": error if math.isfinite(error) else None,
        "at_home": one.at_home,
        "on_front": one.on_front,
        "chosen": one.chosen,
        "why_not": one.fails,
        "survivor": one.survivor,
    }
