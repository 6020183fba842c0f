"""The stiffness policies: when one speaks, who takes over from whom, what each asks for."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

from msgs.emg import CoContraction
from nodes.policy import ASKED_AGAIN, FIRST_CHOICES, PolicyNode
from nodes.policy_auto import Auto, AutoParams
from nodes.policy_emg import Emg, EmgPolicyParams
from nodes.policy_fixed import Fixed, FixedParams
from nodes.policy_information import Information, InformationParams
from nodes.policy_markov import Markov, MarkovParams
from nodes.policy_uniform import Uniform, UniformParams
from palp_core import Bench
from palp_core.errors import GraphError, NodeError
from palp_core.methods import Bound, Method, register
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    RingChoice,
    StiffnessPolicy,
    everywhere,
)
from tests.support.kept import replace, sent_bytes
from tests.support.rig_messages import RINGS_M, belief, learnt, trial

ALL: list[type[PolicyNode]] = [Fixed, Markov, Uniform, Information, Emg, Auto]
every = pytest.mark.parametrize("policy", ALL)


def begun(policy: type[PolicyNode], number: int = 0, **params: Any) -> Bench[Any]:
    """Return a bench after training, at the start of a trial."""
    bench: Bench[Any] = Bench(policy, params, seed=3)
    bench.feed(PolicyNode.primitives, learnt())
    bench.feed(PolicyNode.trial, trial(number))
    return bench


def commanded(bench: Bench[Any]) -> list[tuple[int, int]]:
    return [(c.trial, c.iteration) for c in bench.sent(PolicyNode.command) if not c.rehome]


def rings_m(bench: Bench[Any]) -> list[float]:
    return [c.ring_m for c in bench.sent(PolicyNode.command) if not c.rehome]


# every policy


@every
def test_every_policy_speaks_in_estimation_as_long_as_the_verdict_is_open(policy: type[PolicyNode]) -> None:
    bench: Bench[Any] = Bench(policy)
    bench.feed(PolicyNode.trial, trial(0, "training"))
    bench.feed(PolicyNode.belief, belief(0, 1))
    assert commanded(bench) == []
    bench.feed(PolicyNode.trial, trial(3))
    bench.feed(PolicyNode.belief, belief(3, 1), belief(3, 2), belief(3, 3, "decided"))
    bench.feed(PolicyNode.trial, trial(4))
    bench.feed(PolicyNode.belief, belief(4, 1, "undecided"), belief(3, 4))
    assert commanded(bench) == [(3, 1), (3, 2), (3, 3), (4, 1)]
    assert bench.executor.next_due_ns() is None


@pytest.mark.parametrize(
    ("policy", "params"),
    [
        *((one, {}) for one in ALL),
        (Markov, {"reading": "gaussian_reset"}),
        (Markov, {"mixture": "posterior"}),
    ],
)
def test_a_replacement_of_the_same_policy_continues_byte_for_byte(
    policy: type[PolicyNode], params: dict[str, Any]
) -> None:
    whole, first = begun(policy, **params), begun(policy, **params)
    for bench in (whole, first):
        bench.feed(PolicyNode.belief, belief(0, 1))
    second = replace(first)
    for bench in (whole, second):
        bench.feed(PolicyNode.belief, *(belief(0, i) for i in range(2, 12)))
    assert sent_bytes(first) + sent_bytes(second) == sent_bytes(whole)
    assert set(rings_m(whole)) <= set(RINGS_M)


@pytest.mark.parametrize(("old", "new"), [*itertools.pairwise([*ALL, ALL[0]]), (Information, Fixed)])
def test_any_policy_goes_on_with_the_trial_of_any_other(old: type[PolicyNode], new: type[PolicyNode]) -> None:
    first = begun(old, 7)
    first.feed(PolicyNode.belief, belief(7, 1))
    second = replace(first, new)
    assert second.node.state.ring_m == first.node.state.ring_m
    second.feed(PolicyNode.belief, belief(7, 2), belief(7, 3, "decided"))
    assert commanded(first) + commanded(second) == [(7, 1), (7, 2), (7, 3)]
    assert min(abs(RINGS_M - rings_m(second)[-1])) < 1e-9


@pytest.mark.parametrize("in_a_trial", [True, False])
def test_who_takes_over_says_once_from_which_palpation_on_it_chooses(in_a_trial: bool) -> None:
    first = begun(Fixed, 7) if in_a_trial else Bench(Fixed)
    second = replace(first, Uniform)
    assert second.sent(Uniform.change) == []  # it has chosen nothing yet
    if in_a_trial:
        second.feed(PolicyNode.belief, belief(7, 1), belief(7, 2))
    else:
        second.feed(PolicyNode.trial, trial(7))
    (shown,) = second.sent(Uniform.change)
    assert (shown.trial, shown.iteration, shown.policy) == (7, 2 if in_a_trial else 1, "uniform")
    same = replace(second)
    same.feed(PolicyNode.belief, belief(7, 3))
    assert same.sent(Uniform.change) == []


@pytest.mark.parametrize(
    ("policy", "params", "guilty"),
    [
        (Fixed, FixedParams(ring_mm=20.0), ["ring_mm"]),
        (Fixed, FixedParams(ring_mm=20.0, trained_mm="0 20"), []),
        (Uniform, UniformParams(rings_mm=(4.0, 5.0)), ["rings_mm"]),
        (Markov, MarkovParams(), []),
        (Markov, MarkovParams(trained_mm="0, 16"), [""]),
        (Emg, EmgPolicyParams(trained_mm="0, 16"), [""]),
        (Emg, EmgPolicyParams(start_level=5), ["start_level"]),
        (Information, InformationParams(trained_mm="0, 16"), []),
        (Auto, AutoParams(height_sd_mm=0.5), [""]),  # for which no bound is known
        (Auto, AutoParams(trained_mm="4, 8"), [""]),
        (Auto, AutoParams(noise="no.yaml"), ["noise"]),
        (Fixed, FixedParams(trained_mm="sixteen"), ["trained_mm"]),
        (Fixed, FixedParams(trained_mm="99"), ["trained_mm"]),
        (Fixed, FixedParams(trained_mm=""), ["trained_mm"]),
    ],
)
def test_the_check_names_the_parameter(policy: type[PolicyNode], params: Any, guilty: list[str]) -> None:
    assert list(policy.examine(params)) == guilty


# what training did not cover


@dataclasses.dataclass
class Script:
    """Asks for positions in turn, and for the last one ever after."""

    rings_m: tuple[float, ...]
    asked: int = 0

    def start(self, uniform: Any, trial_count: int | None = None) -> RingChoice:
        self.asked += 1
        return everywhere(min(self.asked, len(self.rings_m)) - 1, trial_count)

    def step(self, at: RingChoice, belief: Any, uniform: Any) -> RingChoice:
        return self.start(uniform)


class Scripted(PolicyNode):
    rings_m: tuple[float, ...] = ()

    def choose(self) -> StiffnessPolicy:
        return Script(self.rings_m)


def scripted(*asked_m: float) -> Bench[Any]:
    return begun(type("Scripted", (Scripted,), {"rings_m": asked_m, "__module__": __name__}))


def test_a_policy_that_asks_for_an_untrained_position_is_asked_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = scripted(0.013, 0.9, 0.008)
    assert rings_m(bench) == [0.008]
    assert "ring position 13 mm is not trained; trained are 0, 4, 8, 12, 16 mm; the policy is" in caplog.text
    bench.feed(PolicyNode.belief, belief(0, 1))
    assert rings_m(bench) == [0.008, 0.008]
    assert len(caplog.records) == 2


@pytest.mark.parametrize(
    ("asked_m", "sent_m"), [(0.013, 0.013), (0.9, 0.049), (-1.0, 0.0), (math.nan, 0.049)]
)
def test_one_that_later_insists_gets_a_position_in_reach_that_ends_its_trial(
    asked_m: float, sent_m: float, caplog: pytest.LogCaptureFixture
) -> None:
    bench = scripted(*[0.008] * FIRST_CHOICES, asked_m)
    bench.feed(PolicyNode.belief, *(belief(0, number + 1) for number in range(FIRST_CHOICES)))
    assert rings_m(bench) == [*[0.008] * FIRST_CHOICES, sent_m]
    assert len(caplog.records) == ASKED_AGAIN


@pytest.mark.parametrize("good", range(FIRST_CHOICES))
def test_one_that_insists_in_its_first_choices_fails_by_name(good: int) -> None:
    bench: Bench[Any] = Bench(type("Odd", (Scripted,), {"rings_m": (*[0.008] * good, 0.017)}))
    bench.feed(PolicyNode.primitives, learnt())

    def palpate() -> None:
        bench.feed(PolicyNode.trial, trial(0))
        bench.feed(PolicyNode.belief, *(belief(0, number + 1) for number in range(good)))

    words = "17 mm is not trained; trained are 0, 4, 8, 12, 16 mm, and Odd insists on it; let it choose"
    with pytest.raises(NodeError, match=words):
        palpate()
    assert rings_m(bench) == [0.008] * good


def test_a_parameter_that_is_not_trained_is_refused_whatever_was_announced() -> None:
    bench: Bench[Any] = Bench(Fixed)
    with pytest.raises(GraphError, match="ring_mm: ring position 13 mm is not trained; trained are 0, 4, 8"):
        bench.set_parameters(ring_mm=13.0)
    bench.feed(PolicyNode.trial, trial(0))
    assert rings_m(bench) == [0.016]
    announced: Bench[Any] = Bench(Fixed, {"trained_mm": "0, 4, 8, 12, 13, 16"})
    announced.set_parameters(ring_mm=13.0)
    announced.set_parameters(ring_mm=16.0)
    announced.feed(PolicyNode.primitives, learnt())
    with pytest.raises(GraphError, match="13 mm is not trained"):
        announced.set_parameters(ring_mm=13.0)


def test_a_policy_that_chooses_nothing_cannot_be_configured() -> None:
    with pytest.raises(Exception, match=r"define choose\(\)"):
        Bench(PolicyNode)


# fixed and uniform


def test_the_fixed_policy_keeps_the_ring_until_a_trial_begins_with_another() -> None:
    bench = Bench(Fixed, {"ring_mm": 12.0})
    bench.feed(PolicyNode.trial, trial(0))
    bench.set_parameters(ring_mm=4.0)
    bench.feed(PolicyNode.belief, belief(0, 1))
    bench.feed(PolicyNode.trial, trial(1))
    assert rings_m(bench) == [0.012, 0.012, 0.004]


@pytest.mark.parametrize("asked_mm", [(0.0, 4.0, 8.0, 12.0, 16.0), (8.0, 12.0, 16.0)])
def test_the_uniform_policy_asks_for_every_position_as_often(asked_mm: tuple[float, ...]) -> None:
    bench = Bench(Uniform, {"rings_mm": list(asked_mm)}, seed=2)
    for number in range(1000):
        bench.feed(PolicyNode.trial, trial(number))
    counts = Counter(rings_m(bench))
    assert sorted(counts) == [ring_mm * 1e-3 for ring_mm in asked_mm]
    assert all(count == pytest.approx(1000 / len(counts), abs=60) for count in counts.values())


# the human's Markov policy


@pytest.mark.parametrize(
    "params", [{}, {"matrices": "tridiagonal"}, {"reading": "mean"}, {"reading": "gaussian_reset"}]
)
def test_the_markov_policy_is_what_its_parameters_describe(params: dict[str, Any]) -> None:
    policy = Bench(Markov, params).node.policy
    assert isinstance(policy, MarkovPolicy)
    np.testing.assert_array_equal(policy.matrices, figure5.matrices(params.get("matrices", "ar1")))
    assert policy.reading == params.get("reading", "column")


@pytest.mark.parametrize("depth", [0, 2])
def test_the_posterior_mixture_follows_the_belief(depth: int) -> None:
    posterior = tuple(float(i == depth) for i in range(3))
    bench = Bench(Markov, {"mixture": "posterior"}, seed=11)
    bench.feed(Markov.trial, trial(0))
    bench.feed(Markov.belief, *(belief(0, i + 1, posterior=posterior) for i in range(600)))
    levels = [figure5.RINGS_M.index(ring_m) for ring_m in rings_m(bench)]
    likelihood = [
        sum(np.log(matrix[after, now]) for now, after in itertools.pairwise(levels))
        for matrix in figure5.matrices()
    ]
    assert int(np.argmax(likelihood)) == depth


def test_after_a_policy_without_a_mean_level_the_mean_is_that_of_the_ring() -> None:
    second = replace(begun(Fixed, ring_mm=16.0), Markov, reading="gaussian_reset")
    second.feed(Markov.belief, belief(0, 1))
    assert second.node.state.mean_level > 0.35


# the information policy

READING: dict[str, Any] = {"posterior": (0.45, 0.45, 0.1), "reading_n_m": 1.45 * 0.016}


def test_it_begins_where_the_depths_differ_most_and_repositions_as_a_repeat_would_share_its_error() -> None:
    bench = begun(Information, height_sd_mm=0.0)
    bench.feed(Information.belief, belief(0, 1, **READING))
    first, again, there = bench.sent(Information.command)
    assert (first.ring_m, first.rehome, again.rehome, there.rehome) == (0.016, False, True, False)
    assert (again.iteration, there.iteration, there.ring_m) == (2, 2, 0.016)


@pytest.mark.parametrize("params", [{"ring_sd_mm": 0.0}, {"knows": "naive"}])
def test_it_stays_where_it_knows_of_nothing_that_stays(params: dict[str, Any]) -> None:
    bench = begun(Information, **params)
    bench.feed(Information.belief, belief(0, 1, **READING))
    assert [c.rehome for c in bench.sent(Information.command)] == [False, False]


def test_before_any_training_it_probes_with_the_stiffest() -> None:
    bench = Bench(Information, {"start_mm": 12.0})
    bench.feed(Information.trial, trial(0))
    bench.feed(Information.belief, belief(0, 1))
    assert rings_m(bench) == [0.012, 0.012]


def test_it_takes_over_what_another_policy_was_reported() -> None:
    new = replace(begun(Uniform), Information)
    new.feed(Information.belief, belief(0, 1, **READING))
    assert new.sent(Information.command)[-1].ring_m == 0.016
    assert new.node.state.primitives["rings_m"] == RINGS_M.tolist()


# the EMG policy


def received(level: int, *, defined: bool = True) -> CoContraction:
    return CoContraction(
        stamp_ns=0,
        start_ns=0,
        rate_hz=1500.0,
        reference_v=1.0,
        value=np.zeros(1),
        burst_count=1,
        level=level,
        level_defined=defined,
    )


def test_the_emg_policy_follows_the_latest_burst_even_of_before_the_trial() -> None:
    bench = Bench(Emg, {"start_level": 0})
    bench.feed(Emg.cocontraction, received(2))
    bench.feed(Emg.trial, trial(0))
    for iteration, level in enumerate((0, 4, 3), start=1):
        bench.feed(Emg.cocontraction, received(level))
        bench.feed(Emg.belief, belief(0, iteration))
    assert rings_m(bench) == [0.008, 0.0, 0.016, 0.012]


def test_until_a_burst_it_stays_in_the_middle_and_in_a_pause_where_it_was() -> None:
    bench = Bench(Emg)
    bench.feed(Emg.cocontraction, received(0, defined=False))
    bench.feed(Emg.trial, trial(0))
    bench.feed(Emg.belief, belief(0, 1))
    assert rings_m(bench) == [0.008, 0.008]


# the register's choice


def test_it_follows_the_registers_choice_and_reports_it_as_chosen() -> None:
    bench = Bench(Auto)
    bench.feed(Auto.trial, trial(0))
    assert rings_m(bench) == [FixedRing().ring_m]
    (published,) = bench.sent(Auto.methods)
    assert [(use.task, use.name, use.asked) for use in published.uses] == [("policy", "fixed", False)]


def test_a_choice_that_cannot_be_made_of_its_defaults_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    needy = Method(
        task="policy", name="needy", place="operator:neg", cost_s=1e-9, bounds=[Bound("decision", 0.01)],
        evidence="the lab",
    )  # fmt: skip
    monkeypatch.setitem(register.register().methods, ("policy", "needy"), needy)
    assert "'needy', which has no default settings" in Auto.examine(AutoParams())[""]
