"""The policy that chooses whole palpations: most bits a second, within the limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msgs.action import ActionPromise, ActionQuestion, PalpationAction
from nodes.choosing.bitrate import Bitrate, BitrateParams, choices_of
from nodes.policy_fixed import Fixed
from nodes.safety import SafetyParams
from palp_core import Bench
from palp_core.errors import NodeError, PerceptionError
from palp_core.palpation.perception.trace.actions import SweepAction
from palp_core.palpation.session.trace.action_time import RigStanding
from palp_core.palpation.session.trace.actions import STOP
from tests.nodes.test_policy_information import belief, learnt, trial

PATH: dict[str, Any] = {"from_m": -0.026, "to_m": 0.034, "lift_mm": 6.0, "rehome": "never"}


def begun(**params: Any) -> Bench[Bitrate]:
    bench = Bench(Bitrate, {**PATH, **params})
    bench.feed(Bitrate.primitives, learnt())
    bench.feed(Bitrate.trial, trial(0))
    return bench


def question(bench: Bench[Bitrate]) -> ActionQuestion:
    return bench.sent(Bitrate.question)[-1]


def promise(asked: ActionQuestion, bits: Any, *refused: str) -> ActionPromise:
    told = np.full(len(asked.ring_m), bits, dtype=float) if np.isscalar(bits) else np.asarray(bits)
    return ActionPromise(
        stamp_ns=0, trial=asked.trial, iteration=asked.iteration, bits=told, refused=list(refused)
    )


def action_of(said: PalpationAction) -> SweepAction:
    return SweepAction(said.ring_m, said.indentation_m, said.speed_m_s, said.from_m, said.to_m)


def test_it_asks_about_every_combination_once_and_takes_the_most_bits_a_second() -> None:
    bench = begun()
    asked = question(bench)
    columns = (asked.ring_m, asked.indentation_m, asked.speed_m_s, asked.from_m, asked.to_m)
    actions = [SweepAction(*row) for row in zip(*(one.tolist() for one in columns), strict=True)]
    assert len(set(actions)) == len(actions) == 5 * 2 * 2 * 8
    assert actions[0] == SweepAction(0.0, 0.004, 0.02, -0.026, 0.034)
    bits = np.random.default_rng(1).uniform(0.2, 1.0, len(actions))
    bench.feed(Bitrate.promise, promise(asked, bits))
    (said,) = bench.sent(Bitrate.action)
    seconds = bench.node.times.seconds(actions, RigStanding())
    assert action_of(said) == actions[int(np.argmax(bits / seconds))]
    assert (said.trial, said.iteration) == (0, 1)
    assert not bench.sent(Bitrate.command)  # the experiment moves the ring, so that it knows of both


def test_who_takes_over_says_from_which_palpation_on_it_chooses(successor: Any) -> None:
    first = Bench(Fixed, {})
    first.feed(Fixed.primitives, learnt())
    first.feed(Fixed.trial, trial(0))
    bench = successor(first, Bitrate, **PATH)
    bench.feed(Bitrate.belief, belief(0, 1))
    bench.feed(Bitrate.promise, promise(question(bench), 1.0))
    (said,) = bench.sent(Bitrate.change)
    assert (said.trial, said.iteration, said.policy) == (0, 2, "bitrate")


def test_a_sweep_back_saves_the_way_back() -> None:
    bench = begun(vary="direction")
    bench.feed(Bitrate.promise, promise(question(bench), 1.0))
    first = action_of(bench.sent(Bitrate.action)[-1])
    bench.feed(Bitrate.belief, belief(0, 1))
    assert question(bench).iteration == 2
    bench.feed(Bitrate.promise, promise(question(bench), 1.0))
    second = action_of(bench.sent(Bitrate.action)[-1])
    assert (second.from_m, second.to_m) == (first.to_m, first.from_m)
    assert second.ring_m == first.ring_m


@pytest.mark.parametrize("word", ["speed", "indentation", "path", "direction"])
def test_each_may_be_left_out(word: str) -> None:
    rest = ", ".join(one for one in ("speed", "indentation", "path", "direction") if one != word)
    asked = question(begun(vary=rest))
    backward = asked.to_m < asked.from_m
    varied = {
        "speed": len(set(asked.speed_m_s)) > 1,
        "indentation": len(set(asked.indentation_m)) > 1,
        "path": len({(min(a, b), max(a, b)) for a, b in zip(asked.from_m, asked.to_m, strict=True)}) > 1,
        "direction": bool(backward.any()),
    }
    assert [name for name, is_varied in varied.items() if not is_varied] == [word]


def test_the_ring_alone_is_left_where_nothing_may_vary() -> None:
    assert len(question(begun(vary="")).ring_m) == 5


@pytest.mark.parametrize(
    ("params", "where", "words"),
    [
        ({"vary": "speed, force"}, "vary", "'force' cannot be chosen"),
        ({"speeds_mm_s": [60.0]}, "speeds_mm_s", "faster than the limit of 50"),
        ({"indentations_mm": [4.5]}, "indentations_mm", "below which it never goes"),
        ({"inset_mm": 30.0}, "inset_mm", "leaves nothing"),
    ],
)
def test_what_the_limits_forbid_is_refused_before_the_run(params: Any, where: str, words: str) -> None:
    numbers: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in params.items()}
    found = Bitrate.examine(BitrateParams(**PATH, **numbers))
    assert list(found) == [where]
    assert words in found[where]


@settings(max_examples=30, deadline=None)
@given(
    speed=st.floats(1.0, 100.0),
    depth=st.floats(0.1, 10.0),
    inset=st.floats(0.0, 40.0),
    fastest=st.floats(0.02, 0.05),
)
def test_nothing_beyond_the_limits_is_ever_asked(
    speed: float, depth: float, inset: float, fastest: float
) -> None:
    numbers: dict[str, Any] = {
        "speeds_mm_s": (speed,), "indentations_mm": (depth,), "inset_mm": inset, "speed_m_s": fastest,
    }  # fmt: skip
    try:
        actions = choices_of(BitrateParams(**PATH, **numbers)).actions((0.0, 0.016))
    except PerceptionError:
        return
    for one in actions:
        assert one.speed_m_per_s <= fastest + 1e-9
        assert one.indentation_m <= 0.004 + 1e-9
        assert -0.026 <= min(one.from_m, one.to_m) < max(one.from_m, one.to_m) <= 0.034


def test_its_limits_are_those_of_the_safety_node() -> None:
    ours, theirs = BitrateParams(), SafetyParams(device="aerotech", stop_link="none")
    assert (ours.stop_n_mm, ours.stop_n, ours.speed_m_s) == (
        theirs.stop_n_mm, theirs.stop_n, theirs.speed_m_s,
    )  # fmt: skip
    asked = question(begun())
    assert (asked.torque_limit_n_m, asked.force_limit_n) == (STOP.torque_n_m, STOP.force_n)


def test_what_is_refused_is_not_chosen_however_quick_it_is() -> None:
    bench = begun()
    asked = question(bench)
    bits = np.full(len(asked.ring_m), -1.0)
    bits[37] = 0.0
    bench.feed(Bitrate.promise, promise(asked, bits, "too much"))
    said = bench.sent(Bitrate.action)[-1]
    assert (said.ring_m, said.speed_m_s) == (asked.ring_m[37], asked.speed_m_s[37])


def test_where_nothing_can_be_promised_the_trial_goes_on_with_the_stiffest() -> None:
    bench = begun()
    bench.feed(Bitrate.promise, promise(question(bench), -1.0, "the estimator reads features"))
    (command,) = bench.sent(Bitrate.command)
    assert (command.ring_m, command.iteration) == (0.016, 1)
    assert not bench.sent(Bitrate.action)
    bench.feed(Bitrate.belief, belief(0, 1))
    assert question(bench).iteration == 2


def test_an_answer_counts_once_and_of_its_own_palpation_only() -> None:
    bench = begun()
    first = question(bench)
    for _ in range(2):
        bench.feed(Bitrate.promise, promise(first, 1.0))
    bench.feed(Bitrate.belief, belief(0, 1))
    bench.feed(Bitrate.promise, promise(first, 1.0))
    assert len(bench.sent(Bitrate.action)) == 1


def test_a_successor_has_the_question_that_is_open(successor: Any) -> None:
    whole, first = begun(), begun()
    bits = np.random.default_rng(2).uniform(0.2, 1.0, len(question(whole).ring_m))
    second = successor(first)
    for bench in (whole, second):
        bench.feed(Bitrate.promise, promise(question(whole), bits))
    assert second.sent(Bitrate.action) == whole.sent(Bitrate.action)


def test_who_takes_over_from_it_answers_for_the_open_question(successor: Any) -> None:
    old = begun()
    new = successor(old, Fixed)
    new.feed(Fixed.promise, promise(question(old), 1.0))
    (command,) = new.sent(Fixed.command)
    assert (command.trial, command.iteration, command.ring_m) == (0, 1, 0.016)
    assert not new.sent(Fixed.action)


def test_what_it_takes_over_it_goes_on_with(successor: Any) -> None:
    old = Bench(Fixed, {})
    old.feed(Fixed.primitives, learnt())
    old.feed(Fixed.trial, trial(0))
    new = successor(old, Bitrate, **PATH)
    new.feed(Bitrate.belief, belief(0, 1))
    assert question(new).iteration == 2
    new.feed(Bitrate.promise, promise(question(new), 1.0))
    assert new.sent(Bitrate.action)[-1].iteration == 2


def test_a_path_without_a_way_is_no_policy() -> None:
    with pytest.raises((NodeError, PerceptionError)):
        Bench(Bitrate, {**PATH, "to_m": -0.026}).feed(Bitrate.trial, trial(0))
