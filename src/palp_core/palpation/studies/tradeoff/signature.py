"""The README's first picture, its data measured, kept, drawn again, and held against the methods' code.

Three questions of the published scene: how wrong is the touch for how much time, how right is the decision
after how many seconds on the rig, and which touch does a decision need.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import PalpError
from palp_core.methods import methods, names, task
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.stopping import FixedNumber, stop_rule
from palp_core.palpation.reporting.charts import save
from palp_core.palpation.session.method_choices import choose_for
from palp_core.palpation.studies.contact.cost import measure_contact
from palp_core.palpation.studies.decision.combinations import Combinations, decision_rows
from palp_core.palpation.studies.decision.rungs import RungJob, rows_of
from palp_core.palpation.studies.frontier.mismatch import sessions_of
from palp_core.palpation.studies.frontier.schemes import SCHEMES, run_schemes
from palp_core.palpation.studies.frontier.study import SEEDS
from palp_core.palpation.studies.frontier.tables import scheme_rows
from palp_core.palpation.studies.frontier.world_session import WorldPlan
from palp_core.palpation.studies.toolkit.parallel import seeds
from palp_core.palpation.studies.tradeoff.judge import panels
from palp_core.palpation.studies.tradeoff.page import made_with, point_record
from palp_core.palpation.studies.tradeoff.panels import signature_chart
from palp_core.palpation.studies.tradeoff.source import method_digest
from palp_core.palpation.studies.tradeoff.survey import TaskSurvey
from palp_core.whole_file import write_json

FOLDER = "docs/signature"
COMMAND = f"palp methods measure --signature --out {FOLDER}"
DATA = "signature.json"
TASKS = ("contact", "policy", "stop", "filter")
"""Tasks whose methods the picture was measured with."""

_OF = Combinations(
    (
        *("fixed_4", "fixed_8", "fixed_12", "fixed_16", "markov", "uniform", "reposition_best"),
        *("information_gain", "information_gain_latent"),
    ),
    {name: stop_rule(name) for name in names("stop")} | {"fixed_1": FixedNumber(1)},
    ("naive", "latent"),
)
_KEPT = ("policy", "stop", "filter", "accuracy", "ci", "seconds", "overconfidence", "sessions")
_RUNGS, _RUNG_FILTERS = ("l0", "l2", "l4", "l5"), ("latent",)
_READ = ("scheme", "reading", "rule", "accuracy", "ci", "seconds", "ece")
_SESSIONS, _READING_SESSIONS, _RUNG_SESSIONS = 20, 40, 6
_DIGITS = 5


def measure_signature(folder: Path, tell: Callable[[str], None] = lambda _: None) -> Path:
    """Measure the data of all three panels, keep them, draw them, and return the picture.

    Args:
        folder: Gets ``signature.json``, ``signature.png`` and ``signature.csv``; made if missing.
        tell: Told what is being measured.
    """
    scene = Scene()
    contact = TaskSurvey(choose_for(task("contact"), scene))
    for point in measure_contact(scene):
        contact.add(point)
        tell(f"1 of 3, contact: {point.method} {point.setting} against {point.against}")
    tell("2 of 3, decisions: policies, stop rules, filters")
    decisions = decision_rows("peak", _OF, _SESSIONS)
    tell("2 of 3, decisions: contrast and whole trace")
    readings = reading_rows()
    tell("3 of 3, decisions by contact rung")
    rungs = [RungJob(rung, ("peak",), _RUNG_FILTERS, _RUNG_SESSIONS, 1) for rung in _RUNGS]
    record = {
        **made_with(),
        "asked": contact.choice.tolerance,
        "chosen": chosen_names(scene),
        "contact": [point_record(one) for one in panels(contact.choice, contact.points)[0].found],
        "decisions": [{key: row[key] for key in _KEPT} for row in decisions],
        "readings": [{key: row[key] for key in _READ} for row in readings],
        "rungs": rows_of(rungs),
        "digests": digests(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / DATA, _rounded(record))
    return draw_signature(folder)


def reading_rows() -> list[dict[str, Any]]:
    """Return a line per scheme of contrast or trace: those of the study ``frontier`` in the paper's world."""
    schemes = tuple(one for one in SCHEMES if one.reading != "peak")
    sessions = seeds(SEEDS, 1, _READING_SESSIONS)
    return scheme_rows("paper", [run_schemes(sessions_of(WorldPlan(), s), schemes) for s in sessions])


def draw_signature(folder: Path) -> Path:
    """Draw the kept data again, and return the picture.

    Raises:
        PalpError: There are none.
    """
    save(signature_chart(read_signature(folder)), folder)
    return folder / "signature.png"


def read_signature(folder: Path) -> dict[str, Any]:
    """Return the kept data.

    Raises:
        PalpError: There are none, or they are no JSON.
    """
    try:
        kept: dict[str, Any] = msgspec.json.decode((folder / DATA).read_bytes())
    except (OSError, msgspec.DecodeError) as error:
        raise PalpError(f"{folder / DATA}: no data to draw ({error}); measure them: {COMMAND}") from error
    return kept


def chosen_names(scene: Scene) -> dict[str, str]:
    """Return the register's choice by task, where there is one."""
    found = {name: choose_for(task(name), scene).chosen for name in TASKS}
    return {name: one.name for name, one in found.items() if one is not None}


def digests() -> dict[str, str]:
    """Return a digest of the code of every method that the picture shows, by ``task/name``."""
    return {f"{name}/{one.name}": method_digest(one) for name in TASKS for one in methods(name)}


def outdated(folder: Path) -> list[str]:
    """Return a sentence for every method whose code is not what the kept data were measured with.

    Raises:
        PalpError: There are no data.
    """
    kept, now = read_signature(folder)["digests"], digests()
    words = {name: "has changed since" if name in kept else "is new since" for name in now}
    words |= {name: "is gone since" for name in kept if name not in now}
    return [
        f"{name.replace('/', ' ')} {words[name]} the README's first picture was measured; run: {COMMAND}"
        for name in sorted(words)
        if kept.get(name) != now.get(name)
    ]


def _rounded(value: Any) -> Any:
    """Return a value with as many digits as are worth keeping."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(one) for one in value]
    return value
