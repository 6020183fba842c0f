"""The run's own warning: how often it is wrong where nothing differs, and that it tells what does."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from palp_core.palpation.perception.belief.session_check import (
    LEVEL,
    LOOK_P,
    MISFIT,
    ClassTrials,
    Projected,
    SessionTrials,
    shifted,
)
from palp_core.units import Float64Array

CLASSES, NAMES = 3, ("height_m", "friction", "modulus", "along_m")


def projected(
    mountings: int = 3,
    stated: float = 0.0,
    names: tuple[str, ...] = NAMES,
    felt: Float64Array | None = None,
    of: int = 0,
    taught: Float64Array | None = None,
) -> Projected:
    zero = np.zeros(len(names))
    return Projected(
        names,
        of,
        zero[None] if felt is None else felt,
        zero,
        np.zeros((0, len(names))) if taught is None else taught,
        np.full(CLASSES, mountings),
        stated,
    )


def session(
    rng: np.random.Generator,
    count: int,
    *,
    mountings: int = 3,
    phantoms: int = 3,
    spread: float = 1.0,
    each: float = 0.5,
    off: float = 0.0,
) -> list[SessionTrials]:
    """A session after 30 trials and after all: what mountings, phantoms and trials are off by is drawn."""
    taught = spread * rng.standard_normal((CLASSES, mountings, len(NAMES)))
    own = spread * rng.standard_normal((CLASSES, phantoms, len(NAMES)))
    of, which = rng.integers(0, CLASSES, count), rng.integers(0, phantoms, count)
    felt = own[of, which] - taught.mean(axis=1)[of] + each * rng.standard_normal((count, len(NAMES)))
    felt[:, 1] += off
    found = []
    for until in (30, count):
        classes = {}
        for m in range(CLASSES):
            here = of[:until] == m
            phantom = {str(k): int((which[:until][here] == k).sum()) for k in range(phantoms)}
            rests = (taught[m] - taught[m].mean(axis=0)) * here.sum() if mountings > 1 else np.zeros((0, 4))
            classes[m] = ClassTrials(
                {key: value for key, value in phantom.items() if value},
                felt[:until][here].sum(axis=0).tolist(),
                (felt[:until][here] ** 2).sum(axis=0).tolist(),
                [0.0] * len(NAMES),
                rests.tolist(),
            )
        found.append(SessionTrials(classes, until))
    return found


def told(sessions: list[SessionTrials], known: Projected) -> bool:
    looks = [shifted(one, known) for one in sessions]
    return any(one is not None and one.p < LOOK_P for one in looks)


@pytest.mark.parametrize("spread", [0.1, 1.0, 10.0])
@pytest.mark.parametrize(
    ("mountings", "phantoms", "each"), [(3, 3, 0.3), (3, 1, 2.0), (2, 1, 0.3), (8, 3, 4.0)]
)
def test_few_sessions_that_differ_in_nothing_are_told_whatever_mountings_spread(
    mountings: int, phantoms: int, each: float, spread: float
) -> None:
    rng = np.random.default_rng(7)
    alarms = sum(
        told(
            session(rng, 120, mountings=mountings, phantoms=phantoms, spread=spread, each=each * spread),
            projected(mountings),
        )
        for _ in range(400)
    )
    assert alarms <= 400 * LEVEL + 3.0 * np.sqrt(400 * LEVEL * (1.0 - LEVEL)) - 5.0  # 28 of 400


def test_trials_of_one_phantom_are_one_witness_and_not_many() -> None:
    rng = np.random.default_rng(8)
    alone = [session(rng, 120, phantoms=1, each=0.1)[-1] for _ in range(200)]
    as_many = [
        SessionTrials(
            {
                m: msgspec.structs.replace(
                    one, phantoms={str(k): 1 for k in range(sum(one.phantoms.values()))}
                )
                for m, one in each.classes.items()
            },
            each.count,
        )
        for each in alone
    ]
    right = sum(told([one], projected()) for one in alone)
    wrong = sum(told([one], projected()) for one in as_many)
    assert right <= 16 < wrong


def test_a_shift_is_told_by_name_and_its_power_grows_with_mountings() -> None:
    rng, power = np.random.default_rng(9), {}
    for mountings in (2, 8):
        found = [
            shifted(session(rng, 120, mountings=mountings, off=2.5)[-1], projected(mountings))
            for _ in range(100)
        ]
        named = [one for one in found if one is not None and one.p < LOOK_P]
        assert all(one.name == "friction" and one.scores > 0.0 for one in named[:50])
        power[mountings] = len(named)
    assert power[2] > 40
    assert power[8] > max(power[2], 90)


def test_with_one_mounting_a_class_what_is_stated_counts_as_two_more() -> None:
    rng = np.random.default_rng(10)
    alike = [
        session(rng, 120, mountings=1, phantoms=1, spread=0.5, each=0.1, off=6.0)[-1] for _ in range(100)
    ]
    stated = sum(told([one], projected(1, 0.5)) for one in alike)
    unstated = sum(told([one], projected(1)) for one in alike)
    assert stated > unstated


def test_a_landing_that_all_trials_share_is_no_difference() -> None:
    rng = np.random.default_rng(11)
    one = session(rng, 120, each=0.1, off=4.0)[-1]
    assert told([one], projected())
    for sums in one.classes.values():
        sums.landing = [4.0 * sum(sums.phantoms.values())] * len(NAMES)
    assert not told([one], projected())


def test_how_badly_trials_fit_is_held_against_how_badly_mountings_do() -> None:
    names = ("friction", MISFIT)
    trials, rng = SessionTrials(), np.random.default_rng(12)
    for number in range(30):
        of = number % CLASSES
        taught = np.column_stack([np.array([-0.1, 0.0, 0.1]), np.array([-1.1, -1.0, -0.9])])
        felt = np.array([[rng.normal(0.0, 0.1), rng.normal(-1.0, 0.1)]])
        trials.add(projected(3, 0.0, names, felt, of, taught), str(number % 9))
    usual = shifted(trials, projected(3, 0.0, names))
    assert usual is not None
    assert usual.p > LOOK_P
    for one in trials.classes.values():
        one.felt[1] += 1.5 * sum(one.phantoms.values())
        one.squares[1] = one.felt[1] ** 2 / sum(one.phantoms.values()) + 0.1
    worse = shifted(trials, projected(3, 0.0, names))
    assert worse is not None
    assert (worse.name, worse.p < LOOK_P) == (MISFIT, True)


def test_it_looks_after_30_trials_and_ever_four_times_as_many_and_survives_a_hand_over() -> None:
    trials, looks = SessionTrials(), []
    one = projected(3, 0.0, felt=np.ones((1, 4)), taught=np.zeros((3, 4)))
    for number in range(1, 500):
        trials.add(replace(one, of=number % 3), "a")
        if trials.due:
            looks.append(number)
    assert looks == [30, 120, 480]
    again = msgspec.msgpack.decode(msgspec.msgpack.encode(trials), type=SessionTrials)
    assert again == trials
    assert shifted(SessionTrials(), one) is None
