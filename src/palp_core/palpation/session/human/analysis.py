"""What sessions with people tell, as the paper has it: accuracy, confusion, ANOVA, time to answer; and power.

Of people only. A simulated person answers by chance or by script, a recording answers nothing: their trials
are counted and described, and no share of right answers is ever computed of them.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.perception.statistics.anova import Anova, NotTestable, permutation, two_way
from palp_core.palpation.perception.statistics.statistics import confusion, wilson
from palp_core.palpation.session.audit import left_out
from palp_core.palpation.session.human.power import Power, power_of
from palp_core.palpation.session.human.record import HumanRow, is_of_a_person, read_human

NO_ACCURACY = "no accuracy: {why}; only what people answered is ever scored"
_SEED = 1


@dataclass(frozen=True)
class HumanTrials:
    """The trials of one session or several that count."""

    rows: tuple[HumanRow, ...]
    left_out: dict[str, int]  # how many do not count, by why
    people: bool  # whether all are of people
    why: str  # why they are not, in words


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
        return {
            "simulated": "the muscles are simulated",
            "emulator": "the amplifier is emulated",
            "file": "the muscles are a recording's",
        }.get(row.source, f"the muscles are of '{row.source}'")
    return "a script answered" if row.answered_by == "script" else "nobody knows who answered"


def analyse(trials: HumanTrials) -> dict[str, Any]:
    """Return what the trials tell, ready for JSON; of what is not of people only what was done."""
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
    if not trials.people:
        why = trials.why or "there is no trial"
        return found | {"note": NO_ACCURACY.format(why=why)}
    if not asked:
        sealed = any(row.answer_s is not None for row in rows)
        why = "the session is sealed" if sealed else "nobody was asked"
        return found | {"note": NO_ACCURACY.format(why=why)}
    return found | _of_people(asked)


def _of_people(rows: Sequence[HumanRow]) -> dict[str, Any]:
    given = sorted({row.depth_m for row in rows if row.depth_m is not None})
    depths = sorted({*given, *(row.estimate_m for row in rows if row.estimate_m is not None)})
    place = {depth: i for i, depth in enumerate(depths)}
    right = [float(row.estimate_m == row.depth_m) for row in rows]
    depth = [f"{(row.depth_m or 0.0) * 1e3:g}" for row in rows]
    number = _number_at_depth(rows)
    table = confusion(
        [place[row.depth_m] for row in rows if row.depth_m is not None],
        [place[row.estimate_m] for row in rows if row.estimate_m is not None],
        len(depths),
    )
    exchanged = permutation(right, depth, [row.subject for row in rows], np.random.default_rng(_SEED))
    return {
        "accuracy": _share(right),
        "by_depth": {
            mm: _share([r for r, d in zip(right, depth, strict=True) if d == mm]) for mm in _mm(given)
        },
        "by_trial": {
            mm: {
                str(n): _share([r for r, d, m in zip(right, depth, number, strict=True) if (d, m) == (mm, n)])
                for n in sorted({*number})
            }
            for mm in _mm(given)
        },
        "confusion": {"depths_mm": [float(mm) for mm in _mm(depths)], "counts": table.tolist()},
        "anova": _anova(two_way(right, depth, number, names=("depth", "trial"))),
        "permutation_p": _reasoned(exchanged),
        "answer_s": {
            mm: _spread(
                [
                    row.answer_s
                    for row, d in zip(rows, depth, strict=True)
                    if d == mm and row.answer_s is not None
                ]
            )
            for mm in _mm(given)
        },
        "palpation_by_depth_s": {
            mm: _spread([row.palpation_s for row, d in zip(rows, depth, strict=True) if d == mm])
            for mm in _mm(given)
        },
        "power": _power(rows, len(given), float(np.mean(right))),
        "note": "trials of one subject are no independent facts; subjects are few",
    }


def _mm(depths: Sequence[float]) -> list[str]:
    return [f"{depth * 1e3:g}" for depth in depths]


def _number_at_depth(rows: Sequence[HumanRow]) -> list[int]:
    """Return for each trial which of its subject's with this depth it is, from 1."""
    seen: Counter[tuple[str, float | None]] = Counter()
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
        "right": int(sum(right)),
        "of": len(right),
        "share": found.value,
        "low": found.low,
        "high": found.high,
    }


def _anova(found: Anova | NotTestable) -> dict[str, Any]:
    if isinstance(found, NotTestable):
        return {"not_testable": found.reason}
    return {"effects": [asdict(one) for one in found.effects], "caution": found.caution}


def _reasoned(found: float | NotTestable) -> Any:
    return {"not_testable": found.reason} if isinstance(found, NotTestable) else found


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
    return {"median": middle, "lower_quartile": low, "upper_quartile": high, "count": len(values)}


def _power(rows: Sequence[HumanRow], depths: int, share: float) -> dict[str, Any]:
    subjects = len({row.subject for row in rows})
    repeats = max(1, round(len(rows) / (subjects * depths)))
    found: Power = power_of(subjects, depths, repeats, share)
    return asdict(found)
