"""Heights that stay with the mounting: what a latent filter knows goes on, and ends with it."""

from __future__ import annotations

import pytest

from msgs.experiment import TrialMount
from nodes.estimator import Estimator
from palp_core import Bench
from palp_core.errors import NodeError
from tests.nodes.test_estimator import MEAN_N_M, palpate, probe, ring, sweep, trained, trial


def felt(bench: Bench[Estimator], number: int, remount: int, peak_n_m: float) -> list[float]:
    """Return the belief after one palpation of a trial on a mounting."""
    bench.feed(Estimator.mount, TrialMount(stamp_ns=0, trial=number, remount=remount))
    bench.feed(Estimator.trial, trial(number, "estimation"))
    bench.feed(Estimator.ring, ring(0.016, number))
    palpate(bench, sweep(peak_n_m))
    answer: list[float] = bench.sent(Estimator.belief)[-1].posterior.tolist()
    return answer


HIGH = {"filter": "latent", "height_sd_mm": 0.3}
BETWEEN_N_M = 0.4 * MEAN_N_M[0.002][0.016] + 0.6 * MEAN_N_M[0.004][0.016]


def test_what_a_latent_filter_knows_of_the_height_stays_with_the_mounting_and_ends_with_it() -> None:
    bench = trained(**HIGH, height_stays="mounting")
    first = felt(bench, 501, 3, BETWEEN_N_M)
    second = felt(bench, 502, 3, BETWEEN_N_M)
    assert second != first
    assert felt(bench, 503, 4, BETWEEN_N_M) == first  # the same phantom may be on: it is another mounting
    assert felt(bench, 504, 4, BETWEEN_N_M) == second
    assert felt(bench, 505, 3, BETWEEN_N_M) == first  # the last mounting is what is known


def test_the_height_is_new_with_every_trial_unless_asked_otherwise() -> None:
    bench = trained(**HIGH)
    assert felt(bench, 501, 3, BETWEEN_N_M) == felt(bench, 502, 3, BETWEEN_N_M)


def test_where_nobody_tells_the_mounting_the_height_is_new_and_it_is_said(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = trained(**HIGH, height_stays="mounting")
    first = felt(bench, 501, 3, BETWEEN_N_M)
    bench.feed(Estimator.trial, trial(502, "estimation"))
    assert probe(bench, BETWEEN_N_M).posterior.tolist() == first
    assert "trial 1: nobody told its mounting; its height is taken as new" in caplog.text


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({}, "the filter 'naive' has no height"),
        ({"filter": "latent_ring"}, "the filter 'latent_ring' has no height"),
        ({"filter": "latent", "depths": 31}, "between trained depths"),
        ({"reading": "trace"}, "the reading 'trace' takes the height as new in every trial"),
    ],
)
def test_a_height_that_could_not_stay_is_refused_before_anything_moves(
    params: dict[str, object], words: str
) -> None:
    with pytest.raises(NodeError, match=words):
        Bench(Estimator, {**params, "height_stays": "mounting"})
