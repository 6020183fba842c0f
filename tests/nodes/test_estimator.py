"""The estimator: from the torque of a sweep to a belief, whatever the blocks and the process."""

from __future__ import annotations

import functools
import itertools
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msgs.estimation import Belief
from msgs.stage import SweepStatus
from nodes.estimator import Estimator
from palp_core import Bench
from palp_core.errors import GraphError, NodeError
from palp_core.methods import register
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.units import Float64Array
from tests.support.kept import replace, sent_bytes
from tests.support.rig_messages import block, ring_state, trial

DEPTHS_M = (0.002, 0.004, 0.008)
RINGS_M = (0.004, 0.016)
COUNT = 2000
MEAN_N_M = {d: {r: 0.5 * r - 0.2 * d + 0.006 for r in RINGS_M} for d in DEPTHS_M}


def sweep(peak_n_m: float, seed: int | None = None, count: int = COUNT) -> Float64Array:
    bump: Float64Array = peak_n_m * np.exp(-(((np.arange(count) - count / 2) / (count / 6)) ** 2))
    return bump if seed is None else bump + np.random.default_rng(seed).normal(0.0, 2e-5, count)


def status(word: str, count: int = 0) -> SweepStatus:
    return SweepStatus(stamp_ns=0, goal_id=1, status=word, sample_count=count)


def palpate(bench: Bench[Estimator], torque_n_m: Float64Array) -> None:
    bench.feed(Estimator.sweep, status("sweeping"))
    bench.feed(Estimator.torque, block(torque_n_m))
    bench.feed(Estimator.sweep, status("swept", len(torque_n_m)))


def train(bench: Bench[Estimator], repeats: int = 6, spread_n_m: float = 1e-4) -> None:
    """Train every depth and ring with peaks around their means."""
    rng = np.random.default_rng(1)
    cells = itertools.product(DEPTHS_M, RINGS_M, range(repeats))
    for number, (depth_m, ring_m, _) in enumerate(cells):
        bench.feed(Estimator.trial, trial(number, "training", depth_m))
        bench.feed(Estimator.ring, ring_state(ring_m, number))
        palpate(bench, sweep(MEAN_N_M[depth_m][ring_m] + spread_n_m * rng.standard_normal()))


def probe(bench: Bench[Estimator], peak_n_m: float, iteration: int = 1, ring_m: float = 0.016) -> Belief:
    bench.feed(Estimator.ring, ring_state(ring_m, 500, iteration))
    palpate(bench, sweep(peak_n_m))
    return bench.sent(Estimator.belief)[-1]


def trained(**params: object) -> Bench[Estimator]:
    """Return a bench at the start of an estimation trial."""
    bench = after_training(**params) if params else replace(after_training())
    bench.feed(Estimator.trial, trial(500, "estimation"))
    return bench


@functools.cache
def after_training(**params: object) -> Bench[Estimator]:
    bench = Bench(Estimator, params)
    train(bench)
    return bench


@settings(max_examples=15, deadline=None)
@given(cuts=st.lists(st.integers(1, COUNT - 1), unique=True, max_size=12), late=st.integers(0, 13))
def test_a_palpation_does_not_depend_on_the_blocks_nor_on_when_the_end_is_reported(
    cuts: list[int], late: int
) -> None:
    torque_n_m = sweep(0.01, seed=4)
    bench = Bench(Estimator)
    bench.feed(Estimator.trial, trial(0, "training", 0.002))
    bench.feed(Estimator.ring, ring_state(0.016))
    bench.feed(Estimator.sweep, status("sweeping"))
    edges = [0, *sorted(cuts), COUNT]
    for number, (begin, end) in enumerate(itertools.pairwise(edges)):
        if number == late:
            bench.feed(Estimator.sweep, status("swept", COUNT))
        bench.feed(Estimator.torque, block(torque_n_m[begin:end], begin))
    if late >= len(edges) - 1:
        bench.feed(Estimator.sweep, status("swept", COUNT))
    (palpation,) = bench.sent(Estimator.palpation)
    clean = denoise(torque_n_m)
    edge = edge_cone()
    np.testing.assert_array_equal(palpation.torque_n_m, torque_n_m)
    assert palpation.peak_n_m == clean[edge:-edge].max()
    assert clean[palpation.peak_index] == palpation.peak_n_m
    assert (palpation.start_ns, palpation.end_ns) == (0, (COUNT - 1) * 1_000_000)


def test_a_cancelled_sweep_leaves_nothing_in_the_next_one() -> None:
    bench = Bench(Estimator)
    bench.feed(Estimator.trial, trial(0, "training", 0.002))
    bench.feed(Estimator.sweep, status("sweeping"))
    bench.feed(Estimator.torque, block(sweep(0.02)[:700]))
    bench.feed(Estimator.sweep, status("cancelled"))
    palpate(bench, sweep(0.01))
    (palpation,) = bench.sent(Estimator.palpation)
    np.testing.assert_array_equal(palpation.torque_n_m, sweep(0.01))


def test_torque_that_is_not_over_the_phantom_is_no_palpation() -> None:
    bench = Bench(Estimator)
    bench.feed(Estimator.trial, trial(0, "training", 0.002))
    bench.feed(Estimator.torque, block(sweep(9.0), over_phantom=False))
    palpate(bench, sweep(0.01))
    assert len(bench.sent(Estimator.palpation)[0].torque_n_m) == COUNT


def test_more_samples_than_the_sweep_had_are_refused() -> None:
    bench = Bench(Estimator)
    bench.feed(Estimator.sweep, status("sweeping"))
    bench.feed(Estimator.torque, block(sweep(0.01)))
    with pytest.raises(NodeError, match=r"2000 torque samples of a sweep of 1500"):
        bench.feed(Estimator.sweep, status("swept", 1500))


def test_it_learns_from_labelled_training_and_from_nothing_else() -> None:
    bench = Bench(Estimator)
    train(bench, repeats=2)
    bench.feed(Estimator.trial, trial(90, "training", 0.002, label_known=False))
    bench.feed(Estimator.ring, ring_state(0.016, 90))
    palpate(bench, sweep(0.5))
    bench.feed(Estimator.trial, trial(91, "estimation"))
    probe(bench, MEAN_N_M[0.002][0.016])
    bench.feed(Estimator.trial, trial(92, "estimation"))
    assert len(bench.node.state.memory.training) == 12
    assert len(bench.sent(Estimator.primitives)) == 1
    np.testing.assert_array_equal(bench.sent(Estimator.primitives)[0].count, 2.0)


def test_a_belief_sums_to_one_and_finds_the_depth() -> None:
    for depth_m in DEPTHS_M:
        belief = probe(trained(), MEAN_N_M[depth_m][0.016])
        assert belief.posterior.sum() == pytest.approx(1.0, abs=1e-12)
        assert belief.estimate_m == depth_m
        assert belief.confidence == belief.posterior.max()
        assert not belief.outlier


def test_a_ring_position_that_was_not_trained_is_named_and_ends_the_trial(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = trained()
    before = probe(bench, MEAN_N_M[0.004][0.016])
    dropped = probe(bench, 0.01, ring_m=0.010)
    assert dropped.verdict == "dropped"
    np.testing.assert_array_equal(dropped.posterior, before.posterior)  # the reading says nothing
    assert "is dropped: ring position 10 mm is not trained; trained are" in caplog.text


def test_after_a_dropped_trial_the_next_one_is_judged_as_ever() -> None:
    bench = trained()
    assert probe(bench, 0.01, ring_m=0.010).verdict == "dropped"
    bench.feed(Estimator.trial, trial(501, "estimation"))
    after, fresh = probe(bench, MEAN_N_M[0.004][0.016]), probe(trained(), MEAN_N_M[0.004][0.016])
    np.testing.assert_array_equal(after.posterior, fresh.posterior)
    assert after.verdict == fresh.verdict


def test_estimation_without_training_is_an_error_that_says_so() -> None:
    bench = Bench(Estimator)
    bench.feed(Estimator.trial, trial(0, "estimation"))
    with pytest.raises(NodeError, match="before any training"):
        probe(bench, 0.01)


AUTO = dict.fromkeys(("denoise", "feature", "filter", "likelihood", "stop"), "auto")


def test_the_registers_choice_is_made_once_reported_and_used(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bench = Bench(Estimator, AUTO)
    assert bench.node.reading.methods == {
        "denoise": "approximation",
        "feature": "contrast",
        "filter": "latent",
        "likelihood": "normal",
        "stop": "posterior_threshold",
    }
    assert caplog.text.count("cheapest") + caplog.text.count("within") >= 5
    assert "feature: contrast: 'decision' within 0.5% (asked: 5.0%)" in caplog.text
    assert "cheaper: peak (not accurate enough: within" in caplog.text
    shown = len(caplog.records)
    bench.feed(Estimator.trial, trial(1, "training", 0.002))
    bench.feed(Estimator.ring, ring_state(0.016, 1))
    palpate(bench, sweep(MEAN_N_M[0.002][0.016], count=4000))
    above_flanks_n_m = bench.sent(Estimator.palpation)[-1].peak_n_m
    assert above_flanks_n_m < MEAN_N_M[0.002][0.016]
    assert len(caplog.records) == shown


def test_what_no_bound_is_known_for_is_not_chosen() -> None:
    with pytest.raises(NodeError, match=r"no stop method gives 'decision' within 5.0%.*height_sd_m = 0.0005"):
        Bench(Estimator, {"stop": "auto", "height_sd_mm": 0.5})
    Bench(Estimator, {"height_sd_mm": 0.5})  # who names a method gets it


def test_a_labs_own_methods_are_used_by_their_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lab_methods.py").write_text(LAB, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(register.register(), "methods", dict(register.register().methods))
    bench = Bench(Estimator, {"feature": "lab_methods:mean", "stop": "lab_methods:at_once"})
    train(bench)
    bench.feed(Estimator.trial, trial(500, "estimation"))
    torque_n_m = sweep(0.01)
    answer = probe(bench, 0.01)
    assert answer.verdict == "decided"
    assert answer.reading_n_m == pytest.approx(float(denoise(torque_n_m).mean()), rel=1e-6)
    sys.modules.pop("lab_methods", None)


LAB = """
from dataclasses import dataclass
import numpy as np
from palp_core.methods import Method
from palp_core.palpation.perception.belief.stopping import StopRule, StopState
from palp_core.palpation.perception.signal.features import Peak

def mean(torque_n_m, *, edge, around=None):
    return Peak(float(torque_n_m.mean()), 0)

@dataclass(frozen=True)
class AtOnce(StopRule):
    level: float = 0.5

    def check(self, step):
        return StopState(np.nan, np.asarray(True))

METHODS = [
    Method(task="feature", name="mean", place="lab_methods:mean", cost_s=1e-6, evidence="the lab"),
    Method(task="stop", name="at_once", place="lab_methods:AtOnce", cost_s=1e-6, evidence="the lab"),
]
"""


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"filter": "latent", "likelihood": "student_t"}, "likelihood 'student_t' is of the filter 'naive'"),
        ({"stop": "fixed_number", "stop_value": 20.0}, "max_probes is 15, but the stop rule"),
        ({"max_probes": 0}, "max_probes must be a whole number of at least 1"),
        *(({task: "magic"}, "magic") for task in ("denoise", "feature", "likelihood", "stop")),
    ],
)
def test_parameters_that_are_unknown_or_contradict_each_other_are_refused_before_anything_moves(
    params: dict[str, str | float], words: str
) -> None:
    with pytest.raises((NodeError, GraphError), match=words):
        Bench(Estimator, params)


def test_rehoming_does_not_count_as_a_ring_command() -> None:
    bench = trained()
    bench.feed(Estimator.ring, ring_state(0.016, 500, 1))
    homing = ring_state(0.0, 500, 0, rehome=True, settled=False)
    bench.feed(Estimator.ring, homing)
    palpate(bench, sweep(MEAN_N_M[0.004][0.016]))
    palpation = bench.sent(Estimator.palpation)[-1]
    assert (palpation.ring_m, palpation.iteration, palpation.trial) == (0.016, 1, 500)


def test_a_changed_stop_rule_holds_from_the_next_probe_on() -> None:
    bench = trained()
    assert probe(bench, MEAN_N_M[0.002][0.016]).verdict == "continue"
    bench.set_parameters(stop="posterior_threshold")
    assert probe(bench, MEAN_N_M[0.002][0.016], 2).verdict == "decided"


def test_a_belief_survives_a_replacement_in_the_middle_of_a_sweep() -> None:
    whole, first = trained(), trained()
    torque_n_m = sweep(MEAN_N_M[0.004][0.004], seed=2)
    for bench in (whole, first):
        probe(bench, MEAN_N_M[0.004][0.016])
        bench.feed(Estimator.ring, ring_state(0.004, 500, 2))
        bench.feed(Estimator.sweep, status("sweeping"))
        bench.feed(Estimator.torque, block(torque_n_m[:900]))
    second = replace(first)
    for bench in (whole, second):
        bench.feed(Estimator.torque, block(torque_n_m[900:], 900))
        bench.feed(Estimator.sweep, status("swept", COUNT))
        probe(bench, MEAN_N_M[0.004][0.016], 3)
    assert sent_bytes(first) + sent_bytes(second) == sent_bytes(whole)
    assert second.executor.node.state == whole.executor.node.state


def test_it_says_its_methods_at_the_beginning_and_when_one_is_changed() -> None:
    bench = Bench(Estimator)
    bench.set_parameters(stop="posterior_threshold", stop_value=0.9)
    bench.set_parameters(filter="latent")
    bench.set_parameters(stop_value=0.95)
    shown = [{use.task: use.name for use in one.uses} for one in bench.sent(Estimator.methods)]
    first = {
        "denoise": "soft_universal",
        "feature": "peak",
        "likelihood": "normal",
        "filter": "naive",
        "stop": "paper_guarded",
    }
    changed = first | {"stop": "posterior_threshold"}
    latent = {task: name for task, name in changed.items() if task != "likelihood"} | {"filter": "latent"}
    assert shown == [first, changed, latent]  # and nothing of what is no method
