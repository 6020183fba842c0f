"""The estimator over sweeps that were chosen: what it promises, reads and hands over."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from msgs.action import ActionPromise, ActionQuestion, PalpationAction
from nodes.estimator import Estimator
from palp_core import Bench
from palp_core.palpation.perception.trace.belief import along, begin_sweep, start
from palp_core.palpation.session.trace.asking import offer_of, terms_of
from palp_core.palpation.session.trace.reader import SweepUnderWay
from palp_core.units import Float64Array
from tests.nodes.conftest import replace, sent_bytes
from tests.palpation.session.trace.test_estimator_trace import (
    COUNT,
    FROM_M,
    SPEED,
    TO_M,
    begin,
    block,
    blocks,
    felt,
    outlooks,
    status,
    trained,
)

BACK = PalpationAction(
    stamp_ns=0, trial=500, iteration=1, goal_id=1, ring_m=0.016, indentation_m=0.004, speed_m_s=SPEED,
    from_m=TO_M, to_m=FROM_M,
)  # fmt: skip


def question(trial: int = 500, iteration: int = 1, torque_limit_n_m: float = 0.1) -> ActionQuestion:
    """Ask about two rings there and back, and one sweep deeper than any limit allows."""
    rings = np.array([0.008, 0.016, 0.008, 0.016])
    ends = np.array([FROM_M, FROM_M, TO_M, TO_M]), np.array([TO_M, TO_M, FROM_M, FROM_M])
    return ActionQuestion(
        stamp_ns=0, trial=trial, iteration=iteration, ring_m=rings, indentation_m=np.full(4, 0.004),
        speed_m_s=np.full(4, SPEED), from_m=ends[0], to_m=ends[1], torque_limit_n_m=torque_limit_n_m,
        force_limit_n=10.0,
    )  # fmt: skip


def under_way(bench: Bench[Estimator]) -> SweepUnderWay:
    sweep = bench.node.state.trace.sweep
    assert sweep is not None
    return sweep


def promises(bench: Bench[Estimator]) -> list[ActionPromise]:
    return bench.sent(Estimator.promise)


def asked(**params: Any) -> Bench[Estimator]:
    bench = trained(**params)
    bench.feed(Estimator.question, question())
    return bench


def swept_back(depth_m: float, seed: int = 1) -> Float64Array:
    """The torque of a sweep back: its sign is turned, and the bead comes from its other side."""
    return -felt(depth_m, seed=seed)[::-1]


def test_it_promises_what_each_sweep_tells_and_more_of_the_stiffer_ring() -> None:
    (told,) = promises(asked())
    assert (told.trial, told.iteration, len(told.bits)) == (500, 1, 4)
    assert told.refused == []
    assert 0.0 < told.bits[0] < told.bits[1] <= np.log2(3.0) + 1e-9


def test_a_load_beyond_the_limits_is_refused_in_words() -> None:
    bench = trained()
    bench.feed(Estimator.question, question(torque_limit_n_m=1e-4))
    (told,) = promises(bench)
    assert (told.bits == -1.0).all()
    assert "a torque of" in told.refused[0]
    bench.feed(Estimator.sweep, status("sweeping"))  # the trial is read as any other
    bench.feed(Estimator.torque, block(felt(0.004)))
    assert outlooks(bench)[-1].estimate_m == 0.004


def test_a_question_about_a_trial_to_come_is_answered_when_it_comes() -> None:
    bench = trained()
    bench.feed(Estimator.question, question(trial=501))
    assert promises(bench) == []
    begin(bench, 501)
    assert [one.trial for one in promises(bench)] == [501]
    bench.feed(Estimator.question, question(trial=499))
    assert len(promises(bench)) == 1


def test_who_reads_features_says_that_nothing_can_be_promised() -> None:
    bench = Bench(Estimator, {})
    bench.node.state.phase, bench.node.state.trial = "estimation", 500
    bench.feed(Estimator.question, question())
    (told,) = promises(bench)
    assert (told.bits == -1.0).all()
    assert "reads features" in told.refused[0]


@pytest.mark.parametrize("depth_m", [0.002, 0.008])
def test_a_sweep_back_is_read_by_the_model_of_sweeps_back(depth_m: float) -> None:
    """Bit by bit the belief that a study has of the same bins."""
    bench = asked(stop="fixed_number", stop_value=1.0)
    bench.feed(Estimator.action, BACK)
    bench.feed(Estimator.sweep, status("sweeping"))
    bench.feed(Estimator.torque, block(swept_back(depth_m)))
    state, watch = bench.node.state, bench.node._watch()
    reader = watch.reader(state.trace)
    assert reader.known is not None
    bins = under_way(bench).felt(watch.settings, 0.016, landed=True).torque_n_m
    assert min(bins) > 0.0
    setting = reader.known.setting[3]
    first = begin_sweep(start(reader.known.model), setting, landed=True)
    _, posterior = along(reader.known.model, first, np.array(bins))
    np.testing.assert_array_equal(outlooks(bench)[-1].posterior, posterior[0, -1])
    bench.feed(Estimator.sweep, status("swept", COUNT))
    (belief,) = bench.sent(Estimator.belief)
    assert belief.reading_n_m == pytest.approx(np.max(-swept_back(depth_m)))
    (kept,) = state.trace.felt
    assert kept.terms == terms_of(BACK)


def test_a_refusal_changes_nothing() -> None:
    bench = asked()
    bench.feed(Estimator.action, PalpationAction(**{**fields(BACK), "refused": "too fast"}))
    bench.feed(Estimator.sweep, status("sweeping"))
    assert under_way(bench).terms is None


def test_what_is_swept_as_the_launch_file_says_again_is_read_so() -> None:
    bench = asked()
    bench.feed(Estimator.action, BACK)
    bench.feed(Estimator.action, PalpationAction(**{**fields(BACK), "asked": False}))
    bench.feed(Estimator.sweep, status("sweeping"))
    assert under_way(bench).terms is None


def test_what_was_asked_of_another_goal_does_not_count() -> None:
    """A stage that was restarted has forgotten what it told."""
    bench = asked()
    bench.feed(Estimator.action, PalpationAction(**{**fields(BACK), "goal_id": 7}))
    bench.feed(Estimator.sweep, status("sweeping"))
    assert under_way(bench).terms is None


def fields(action: PalpationAction) -> dict[str, Any]:
    return {name: getattr(action, name) for name in action.__struct_fields__}


def test_a_sweep_that_nobody_asked_the_estimator_about_is_read_all_the_same() -> None:
    bench = trained()
    bench.feed(Estimator.action, BACK)
    bench.feed(Estimator.sweep, status("sweeping"))
    bench.feed(Estimator.torque, block(swept_back(0.004)))
    assert len(outlooks(bench)) == 1
    assert outlooks(bench)[0].bin_count > 0


@pytest.mark.parametrize("at", [0, 9, 30])
def test_a_replacement_goes_on_in_the_middle_of_a_sweep_back_to_the_same_bytes(at: int) -> None:
    whole, first = asked(stop_value=0.9999), asked(stop_value=0.9999)
    for bench in (whole, first):
        bench.feed(Estimator.action, BACK)
        bench.feed(Estimator.sweep, status("sweeping"))
    feed = blocks(swept_back(0.004))
    for one in feed[:at]:
        first.feed(Estimator.torque, one)
    second = replace(first)
    for one in feed:
        whole.feed(Estimator.torque, one)
    for one in feed[at:]:
        second.feed(Estimator.torque, one)
    for bench in (whole, second):
        bench.feed(Estimator.sweep, status("swept", COUNT))
        bench.feed(Estimator.question, question(iteration=2))
    assert sent_bytes(first) + sent_bytes(second) == sent_bytes(whole)
    assert len(promises(second)) == 1


def test_the_same_sweep_once_more_is_promised_next_to_nothing() -> None:
    bench = asked(stop="fixed_number", stop_value=2.0)
    bench.feed(Estimator.sweep, status("sweeping"))
    bench.feed(Estimator.torque, block(felt(0.004)))
    bench.feed(Estimator.sweep, status("swept", COUNT))
    bench.feed(Estimator.question, question(iteration=2))
    first, second = promises(bench)
    assert second.bits[1] < 0.1 * first.bits[1]


def test_a_question_is_the_offer_that_it_lists() -> None:
    offer = offer_of(question())
    assert [one.ring_m for one in offer.actions] == [0.008, 0.016, 0.008, 0.016]
    assert [one.backward for one in offer.actions] == [False, False, True, True]
    assert (offer.limits.torque_n_m, offer.limits.force_n) == (0.1, 10.0)
