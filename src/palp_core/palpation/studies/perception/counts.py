"""Errors of tasks ``burst`` and ``test``: bursts lost or invented, and alarms where nothing differs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.methods import names
from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState
from palp_core.palpation.perception.emg.bursts import BurstRule
from palp_core.palpation.perception.emg.emg import EmgChain, cocontraction, find_offset
from palp_core.palpation.perception.emg.peaks import EmgPeak, PeakFinder, distance_first
from palp_core.palpation.perception.statistics.anova import Anova, NotTestable, fisher, permutation, two_way
from palp_core.palpation.perception.statistics.mixed_logit import mixed_logit
from palp_core.palpation.perception.statistics.resampling import sign_flip
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.studies.perception.case import Seen
from palp_core.units import Float64Array

_SEED = 33
_BLOCK_NS = 10_000_000

# burst: one for every level that a simulated person holds


@dataclass(frozen=True, eq=False)
class Recording:
    """A minute of a person who palpates.

    Attributes:
        value: Co-contraction, dimensionless, shape (n,).
        held: First sample of every level that is held, and the last of all, shape (k + 1,).
        rate_hz: Sampling rate.
        rest: Co-contraction at rest, and its standard deviation, dimensionless.
    """

    value: Float64Array
    held: Float64Array
    rate_hz: float
    rest: tuple[float, float]


def recording(relax_share: float, window_s: float, seed: int, duration_s: float = 60.0) -> Recording:
    """Return co-contraction of a simulated person, who relaxes by a share between two levels.

    Args:
        relax_share: Share of a level that is given up before the next.
        window_s: RMS window.
        seed: Of the person.
        duration_s: Of the palpation.
    """
    person = SimEmg(figure5.matrices().mean(axis=0), relax_share=relax_share)
    state, rng = SimEmgState(), np.random.default_rng((_SEED, seed))
    person.open(0, state, rng)
    begin_ns = person.palpation_ns(state)
    blocks, held = [], []
    left = 0
    for now_ns in range(_BLOCK_NS, begin_ns + round(duration_s * 1e9), _BLOCK_NS):
        block = person.drain(now_ns, state, rng)
        blocks.append(np.stack([block.fds_v, block.edc_v]))
        if state.left_count > left:  # a level began within this block
            held.append(state.sample_count - blocks[-1].shape[1] / 2)
        left = state.left_count
    samples = np.concatenate(blocks, axis=1)
    rest = samples[:, : round(person.rest_s * person.rate_hz)]
    envelopes = []
    for muscle, quiet in zip(samples, rest, strict=True):
        chain = EmgChain(offset=find_offset(quiet), rate_hz=person.rate_hz, window_s=window_s)
        envelopes.append(chain.step(chain.start(), muscle)[1])
    first = round(begin_ns * 1e-9 * person.rate_hz)
    reference = float(sum(one[:first].max() for one in envelopes))
    value = cocontraction(np.array(envelopes), reference)[first:]
    late = window_s / 2.0 * person.rate_hz + 2.0 * person.smooth_s * person.rate_hz
    ends = np.array([*held, samples.shape[1]]) - first + late
    quiet = cocontraction(np.array(envelopes), reference)[round(window_s * person.rate_hz) : rest.shape[1]]
    middle = float(np.median(quiet))
    spread = 1.4826 * float(np.median(np.abs(quiet - middle)))
    return Recording(value, ends, person.rate_hz, (middle, spread))


def astray(found: Sequence[EmgPeak], of: Recording) -> float:
    """Return the peaks lost and invented over the levels that were held."""
    counts, _ = np.histogram([one.index for one in found], of.held)
    return float(np.abs(counts - 1).sum() / counts.size)


def _peaks(name: str, of: Recording) -> Sequence[EmgPeak]:
    """Return the peaks that a declared rule finds."""
    if name == "two_thresholds":
        return BurstRule(of.rate_hz, *of.rest).whole(of.value).peaks
    rule = PeakFinder(of.rate_hz, distance_s=0.4)
    return rule.whole(of.value) if name == "prominence_first" else distance_first(rule, of.value)


def bursts_seen(*, quick: bool = False) -> list[Seen]:
    """Return the errors of every rule for bursts by relaxation and window; quick: one recording of each."""
    found = []
    for window_s in (0.15, 0.05):
        for relax_share in (0.5, 0.8):
            minutes = [recording(relax_share, window_s, seed) for seed in range(1 if quick else 10)]
            where = {"window_s": window_s, "relax_share": relax_share, "burst_distance_s": 0.4}
            words = f"window {window_s:g} s, relaxed by {relax_share:g}"
            for name in names("burst"):
                error = float(np.mean([astray(_peaks(name, one), one) for one in minutes]))
                found.append(Seen("burst", name, "bursts", error, where, words))
    return found


# test: alarms above the nominal level where two conditions do not differ

LEVEL = 0.05


@dataclass(frozen=True)
class Design:
    """Sessions in which two conditions do not differ on average.

    Attributes:
        session_count: Sessions, each with both conditions.
        session_sd: Spread over sessions of the logit of being right, the same for both conditions.
        paired_sd: Spread over sessions of the logit's difference between the conditions.
        trials: Of each condition in a session.
        share: Share of right decisions.
    """

    session_count: int
    session_sd: float
    paired_sd: float
    trials: int = 30
    share: float = 0.85

    def draw(self, rng: np.random.Generator) -> Float64Array:
        """Return right and wrong, shape (sessions, 2, trials)."""
        shape = (self.session_count, 1, 1)
        logit = np.log(self.share / (1.0 - self.share)) + self.session_sd * rng.standard_normal(shape)
        apart = 0.5 * self.paired_sd * rng.standard_normal(shape) * np.array([[1.0], [-1.0]])
        right = rng.random((self.session_count, 2, self.trials)) < 1.0 / (1.0 + np.exp(-logit - apart))
        return np.asarray(right, dtype=np.float64)


def p_value(name: str, right: Float64Array, rng: np.random.Generator) -> float:
    """Return the p-value of a declared test, 1 where it finds nothing to test.

    Args:
        name: Of task ``test``.
        right: As of :meth:`Design.draw`.
        rng: For tests by resampling.
    """
    sessions, _, trials = right.shape
    session, group = (index.ravel() for index in np.indices(right.shape)[:2])
    flat = right.ravel()
    if name == "sign_flip":
        return sign_flip(right[:, 0].mean(axis=1) - right[:, 1].mean(axis=1), rng)
    if name == "fisher":
        (first, second), each = right.sum(axis=(0, 2)).astype(int).tolist(), sessions * trials
        return fisher((first, each), (second, each))
    if name == "permutation":
        answer = permutation(flat, group, session, rng, shuffles=200)
        return 1.0 if isinstance(answer, NotTestable) else answer
    if name == "anova":
        told = two_way(flat, group, session, names=("condition", "session"))
        return told.effects[0].p if isinstance(told, Anova) else 1.0
    fitted = mixed_logit(flat, {"condition": group}, session)
    return 1.0 if isinstance(fitted, NotTestable) else fitted[0].p


_COSTLY = {"anova": 40, "mixed_logit": 400}
"""Repetitions of what takes longest."""
DESIGNS = (
    Design(20, 0.0, 0.0),
    Design(20, 1.0, 0.0),
    Design(20, 1.0, 1.0),
    Design(8, 1.0, 1.0),
    Design(4, 1.0, 1.0),
)


def alarms_seen(*, quick: bool = False) -> list[Seen]:
    """Return by how much every test's alarms are above the nominal 5 %; quick: few, the costly left out."""
    found = []
    for design in DESIGNS:
        for name in names("test"):
            if quick and name in _COSTLY:
                continue
            rng = np.random.default_rng(_SEED)
            repeats = 100 if quick else _COSTLY.get(name, 1000)
            alarms = np.mean([p_value(name, design.draw(rng), rng) <= LEVEL for _ in range(repeats)])
            where = {
                "session_count": float(design.session_count),
                "session_sd": design.session_sd,
                "paired_sd": design.paired_sd,
            }
            words = f"{design.session_count} sessions, logit sd {design.session_sd:g}, {design.paired_sd:g}"
            found.append(Seen("test", name, "level", max(float(alarms) - LEVEL, 0.0), where, words))
    return found
