"""What sessions with people come to, as in the paper: accuracy, confusion, ANOVA, time to answer.

Of people only. A simulated person answers by chance or by script, a recording answers nothing: their trials
are counted and described, and no share of right answers is ever computed of them.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.perception.statistics.anova import NotTestable, permutation, two_way
from palp_core.palpation.perception.statistics.statistics import confusion, wilson
from palp_core.palpation.session.audit import left_out
from palp_core.palpation.session.human.record import HumanRow, is_of_a_person, read_human
from palp_core.palpation.session.recorded_session import mm

NO_ACCURACY = "no accuracy: {why}; only what people answered is ever scored"
_SEED = 1
_WHOSE = {
    "simulated": "the muscles are simulated",
    "emulator": "the amplifier is emulated",
    "file": "the muscles are a recording's",
}


@dataclass(frozen=True)
class HumanTrials:
    """The trials of one session or several that count."""

    rows: tuple[HumanRow, ...]
    left_out: dict[str, int]  # how many do not count, by why
    people: bool  # whether all are of people
    why: str  # why they are not


def gather(folders: Sequence[Path]) -> HumanTrials:
    """Return the trials of sessions; each subject's sessions must be there once."""
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise PalpError("a session is named twice; a trial counts once")
    rows: list[HumanRow] = []
    dropped: Counter[str] = Counter()
    for folder in folders:
        decided = left_out(folder)
        for row in read_human(folder):
            if row.ended_by == "repeat":
                dropped["spoilt and done again"] += 1
            elif (row.phase, row.trial) in decided:
                dropped[decided[row.phase, row.trial].partition(":")[0]] += 1
            else:
                rows.append(row)
    others = sorted({_whose(row) for row in rows if not is_of_a_person(row)})
    return HumanTrials(tuple(rows), dict(dropped), bool(rows) and not others, " and ".join(others))


def _whose(row: HumanRow) -> str:
    if row.source != "person":
        return _WHOSE.get(row.source, f"the muscles are of '{row.source}'")
    return "a script answered" if row.answered_by == "script" else "it is unknown who answered"


def analyse(trials: HumanTrials) -> dict[str, Any]:
    """Return the analysis, ready for JSON; of what is not of people only what was done."""
    rows = trials.rows
    found: dict[str, Any] = {
        "subjects": len({row.subject for row in rows}),
        "trials": {phase: sum(row.phase == phase for row in rows) for phase in ("training", "estimation")},
        "left_out": trials.left_out,
        "ended_by": dict(Counter(row.ended_by for row in rows)),
        "palpation_s": _spread([row.palpation_s for row in rows]),
        "emg": {
            "lost_samples": sum(row.lost_count for row in rows),
            "clipped_samples": sum(row.clipped_count for row in rows),
            "without_emg": sum(not row.emg for row in rows),
        },
        "accuracy": None,
    }
    asked = [row for row in rows if row.estimate_m is not None and row.depth_m is not None]
    if trials.people and asked:
        return found | _of_people(asked)
    why = trials.why or "there is no trial"
    if trials.people:
        why = (
            "the session is sealed"
            if any(row.answer_s is not None for row in rows)
            else "no question was asked"
        )
    return found | {"note": NO_ACCURACY.format(why=why)}


def _of_people(rows: Sequence[HumanRow]) -> dict[str, Any]:
    given = sorted({row.depth_m or 0.0 for row in rows})
    depths = sorted({*given, *(row.estimate_m or 0.0 for row in rows)})
    right = [float(row.estimate_m == row.depth_m) for row in rows]
    depth = [mm(row.depth_m or 0.0) for row in rows]
    number = _number_at_depth(rows)
    by_depth: dict[str, list[int]] = {mm(one): [] for one in given}
    for i, one in enumerate(depth):
        by_depth[one].append(i)
    table = confusion(
        [depths.index(row.depth_m or 0.0) for row in rows],
        [depths.index(row.estimate_m or 0.0) for row in rows],
        len(depths),
    )
    exchanged = permutation(right, depth, [row.subject for row in rows], np.random.default_rng(_SEED))
    anova = two_way(right, depth, number, names=("depth", "trial"))
    return {
        "accuracy": _share(right),
        "by_depth": {one: _share([right[i] for i in places]) for one, places in by_depth.items()},
        "by_trial": {
            one: {str(n): _share([right[i] for i in places if number[i] == n]) for n in sorted({*number})}
            for one, places in by_depth.items()
        },
        "confusion": {"depths_mm": [float(mm(one)) for one in depths], "counts": table.tolist()},
        "anova": {"not_testable": anova.reason}
        if isinstance(anova, NotTestable)
        else {"effects": [asdict(one) for one in anova.effects], "caution": anova.caution},
        "permutation_p": {"not_testable": exchanged.reason}
        if isinstance(exchanged, NotTestable)
        else exchanged,
        "answer_s": {
            one: _spread([s for i in places if (s := rows[i].answer_s) is not None])
            for one, places in by_depth.items()
        },
        "palpation_by_depth_s": {
            one: _spread([rows[i].palpation_s for i in places]) for one, places in by_depth.items()
        },
        "note": "trials of one subject are no independent facts; subjects are few",
    }


def _number_at_depth(rows: Sequence[HumanRow]) -> list[int]:
    """Return for each trial which of its subject's with this depth it is, from 1."""
    seen: dict[tuple[str, float | None], int] = defaultdict(int)
    found = []
    for row in rows:
        seen[row.subject, row.depth_m] += 1
        found.append(seen[row.subject, row.depth_m])
    return found


def _share(right: Sequence[float]) -> dict[str, Any] | None:
    if not right:
        return None
    found = wilson(int(sum(right)), len(right))
    return {
        "right": int(sum(right)), "of": len(right), "share": found.value, "low": found.low, "high": found.high
    }  # fmt: skip


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
    return {"median": middle, "lower_quartile": low, "upper_quartile": high, "count": len(values)}
