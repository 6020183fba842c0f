"""EMG of known bursts and levels by two public generators, NeuroKit2 and BioSPPy.

Neither is a dependency of palp: ``pip install neurokit2 biosppy peakutils``. Both make noise
that begins and ends at once (uniform: NeuroKit2's ``emg_simulate``, BioSPPy's ``synth_uniform``), BioSPPy
also noise that swells as a Gaussian (``synth_gaussian``, after Ghislieri et al., 2021). Two muscles are two
calls; NeuroKit2 knows one strength, so its bursts are scaled.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.emg_known import Contraction, Score, added, score
from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.units import Float64Array

RATE_HZ = 1000
MVC_S, REST_S = 5.0, 2.0


@dataclass(frozen=True)
class Plan:
    """Bursts that are to be made: when they begin, how long they last, s, and their levels."""

    begin_s: Float64Array
    held_s: Float64Array
    levels: Float64Array
    duration_s: float


def planned(count: int, rng: np.random.Generator, *, even: bool) -> Plan:
    """Return bursts of 0.8 to 2.5 s, or all of 1.5 s, with rests of 0.5 to 2 s, or all of one."""
    held_s = np.round(rng.uniform(0.8, 2.5, count), 3)
    rest_s = np.full(count + 1, 1.0) if even else np.round(rng.uniform(0.5, 2.0, count + 1), 3)
    begin_s = np.concatenate([[0.0], np.cumsum(held_s[:-1])]) + np.cumsum(rest_s[:-1])
    return Plan(begin_s, held_s, rng.choice(np.asarray(LEVELS), count), float(held_s.sum() + rest_s.sum()))


def neurokit2_uniform(plan: Plan, seed: int) -> Float64Array:
    """Return a muscle by ``neurokit2.emg_simulate``; its rests are all of one length."""
    from neurokit2 import emg_simulate

    made = emg_simulate(
        duration=plan.duration_s,
        sampling_rate=RATE_HZ,
        burst_number=len(plan.levels),
        burst_duration=plan.held_s.tolist(),
        random_state=seed,
    )
    samples = np.asarray(made, dtype=np.float64)
    for begin_s, held_s, level in zip(plan.begin_s, plan.held_s, plan.levels, strict=True):
        burst = slice(round(begin_s * RATE_HZ), round((begin_s + held_s) * RATE_HZ))
        samples[burst] = 0.08 + level * (samples[burst] - 0.08)  # 0.08 is its offset
    return samples


def biosppy_uniform(plan: Plan, seed: int) -> Float64Array:
    """Return a muscle by ``biosppy.synthesizers.emg.synth_uniform``."""
    from biosppy.synthesizers.emg import synth_uniform

    samples, _, _ = synth_uniform(
        duration=int(np.ceil(plan.duration_s)),
        sampling_rate=RATE_HZ,
        noise=0.005,
        burst_number=len(plan.levels),
        burst_duration=plan.held_s.tolist(),
        burst_location=plan.begin_s.tolist(),
        amplitude_mult=plan.levels.tolist(),
        random_state=seed,
    )
    return np.asarray(samples)


def biosppy_gaussian(plan: Plan, seed: int) -> Float64Array:
    """Return a muscle by ``synth_gaussian``, a call a burst; noise is a hundredth of MVC.

    A burst lasts five standard deviations of its Gaussian, as BioSPPy's default does; what is one burst of
    the plan alone, the MVC, is the middle of a wide one.
    """
    from biosppy.synthesizers.emg import synth_gaussian

    parts, at = [], 0
    for number, (begin_s, held_s, level) in enumerate(
        zip(plan.begin_s, plan.held_s, plan.levels, strict=True)
    ):
        alpha = 0.25 if len(plan.levels) == 1 else 2.5
        following = plan.begin_s[number + 1] if number + 1 < len(plan.levels) else plan.duration_s
        end = round(following * RATE_HZ)
        for longer_s in np.arange(20) / RATE_HZ:  # of some lengths its window is a sample too long for it
            try:
                samples, _, _ = synth_gaussian(
                    duration=int(np.ceil((end - at) / RATE_HZ)) + 1,
                    sampling_rate=RATE_HZ,
                    SNR=float(20.0 * np.log10(100.0 * level)),
                    sigma=float(held_s + longer_s) / (2.0 * alpha),
                    alpha=alpha,
                    burst_location=[round(float(begin_s) - at / RATE_HZ, 3)],
                    random_state=seed * 1000 + number,
                )
            except ValueError:
                continue
            parts.append(np.asarray(samples)[: end - at])
            at = end
            break
        else:
            raise ValueError(f"synth_gaussian makes no burst of {held_s:g} s or a little more")
    return np.concatenate(parts)


PEERS: dict[str, Callable[[Plan, int], Float64Array]] = {
    "NeuroKit2, uniform noise": neurokit2_uniform,
    "BioSPPy, uniform noise": biosppy_uniform,
    "BioSPPy, swelling as a Gaussian": biosppy_gaussian,
}
"""Muscles by public generators, of a plan and a seed."""


def judge_peer(name: str, *, subjects: int, count: int, seed: int) -> Score:
    """Return how so many subjects' bursts are read; rest is the first two seconds of the MVC's recording.

    Args:
        name: Of :data:`PEERS`.
        subjects: Each with an MVC of its own.
        count: Bursts of each.
        seed: Of the first subject.
    """
    make, settings, scores = PEERS[name], EmgSettings(rate_hz=float(RATE_HZ)), []
    for one in range(subjects):
        plan = planned(count, np.random.default_rng((seed + one, 18)), even=make is neurokit2_uniform)
        effort = Plan(np.array([REST_S]), np.array([MVC_S]), np.array([1.0]), 2.0 * REST_S + MVC_S)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of rounding a burst's length to samples
            trial, mvc = (
                np.array([make(each, 10 * (seed + one) + 4 * part + k) for k in range(2)])
                for part, each in enumerate((plan, effort))
            )
        rest = mvc[:, : round(REST_S * RATE_HZ)]
        made = [
            Contraction(round(begin * RATE_HZ), round((begin + held) * RATE_HZ), float(level))
            for begin, held, level in zip(plan.begin_s, plan.held_s, plan.levels, strict=True)
        ]
        scores.append(score(analyse(trial, mvc, settings, rest=rest), made, settings))
    return added(scores)
