"""What a run tells of trials that do not fit what training taught."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.palpation.perception.belief.primitives import Primitives, fit
from palp_core.palpation.perception.belief.session_check import MISFIT, Projected, SessionTrials
from palp_core.palpation.session.unlike_training import by_readings, unlike_training

DEPTHS_M, RINGS_M = (0.002, 0.004, 0.008), (0.008, 0.016)


def memory() -> Primitives:
    """Readings that hardly scatter; at the first ring there are none."""
    rng = np.random.default_rng(1)
    cells = [(d, r) for d in DEPTHS_M for r in RINGS_M for _ in range(25)]
    mean = np.array([r * (1.0 - 50.0 * d) if r > 0.01 else 1e-6 for d, r in cells])
    return fit(
        mean + rng.normal(0.0, 1e-6, len(cells)),
        [DEPTHS_M.index(d) for d, _ in cells],
        [RINGS_M.index(r) for _, r in cells],
        depths_m=DEPTHS_M,
        rings_m=RINGS_M,
        floor=1e-6,
    )


def said(readings: list[float], *, ring_sd_m: float = 0.0) -> str:
    """Return what is said of trials whose readings are such shares of training's, class by class in turn."""
    known, trials = memory(), SessionTrials()
    words = [
        unlike_training(
            trials, by_readings(known, [(share * known.mean[n % 3, 1], 1, True)], n % 3, ring_sd_m), ""
        )
        for n, share in enumerate(readings)
    ]
    told = [one for one in words if one]
    assert len(told) <= 1
    assert trials.told == (told[0] if told else "")
    return trials.told


def test_readings_that_are_all_off_are_told_and_such_as_scatter_are_not() -> None:
    rng = np.random.default_rng(2)
    assert "as if their readings were smaller" in said((0.95 + rng.normal(0.0, 1e-3, 60)).tolist())
    assert said((1.0 + rng.normal(0.0, 1e-3, 60)).tolist()) == ""
    by_class = np.tile([1.1, 0.95, 1.0], 20)  # each mounted a little otherwise
    assert said(by_class.tolist()) == ""


def test_a_landing_that_all_share_is_nothing_to_tell() -> None:
    assert said([1.01] * 60)
    assert said([1.01] * 60, ring_sd_m=0.17e-3) == ""


def test_what_there_is_nothing_to_compare_with_is_left_out() -> None:
    assert by_readings(memory(), [(2e-6, 0, True)], 0, 0.0) is None
    trials = SessionTrials()
    assert unlike_training(trials, None, "") == ""
    assert trials.count == 0


@pytest.mark.parametrize(("sign", "words"), [(3.0, "worse than"), (-3.0, "better than")])
def test_trials_that_fit_worse_than_mountings_are_told_so(sign: float, words: str) -> None:
    trials, rng = SessionTrials(), np.random.default_rng(3)
    taught = np.array([[-1.2], [-1.0], [-0.8]])
    for number in range(30):
        one = Projected(
            (MISFIT,),
            number % 3,
            rng.normal(sign - 1.0, 0.1, (1, 1)),
            np.zeros(1),
            taught,
            np.full(3, 3),
            0.75,
        )
        found = unlike_training(trials, one, str(number % 9))
    assert words in found
