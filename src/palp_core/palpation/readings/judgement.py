"""Trials judged one by one: which setting next, what to believe, when to stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import bayes
from palp_core.palpation.perception.belief.information import gain_vector
from palp_core.palpation.perception.belief.stopping import StopRule, decide
from palp_core.palpation.perception.belief.vector_gain import ExpectedGain
from palp_core.palpation.perception.belief.vector_primitives import VectorPrimitives
from palp_core.palpation.perception.strategy.policies import UniformDraw, draw
from palp_core.palpation.readings.readings import Readings
from palp_core.palpation.readings.training import Fold
from palp_core.units import Float64Array

POLICIES = ("recorded", "fixed", "uniform", "information_gain")
"""Which of a trial's readings is next: as they were taken; at one setting; at any; where most is expected."""


@dataclass(frozen=True)
class TrialRows:
    """A trial to judge.

    Attributes:
        class_index: What was felt.
        trial_index: Its name; another class may have a trial of that name.
        rows: Its readings in the order in which they were taken.
    """

    class_index: int
    trial_index: int
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class JudgedTrial:
    """A trial and what was made of it.

    Attributes:
        trial: Which.
        posterior: The last belief, shape (m,).
        rows: The readings that were used, in that order.
        verdict: ``decided``, ``undecided`` after the most readings allowed, or ``ran_out`` where the rule
            wanted more than the trial holds.
        right_after: Whether the most probable class was the true one after 1, 2, ... readings.
    """

    trial: TrialRows
    posterior: Float64Array
    rows: tuple[int, ...]
    verdict: str
    right_after: tuple[bool, ...]

    @property
    def estimate(self) -> int:
        """The most probable class."""
        return int(np.argmax(self.posterior))

    @property
    def confidence(self) -> float:
        """Its probability."""
        return min(float(self.posterior[self.estimate]), 1.0)

    @property
    def right(self) -> bool:
        """Whether it is the true one; an undecided trial has an estimate too."""
        return self.estimate == self.trial.class_index


def trials_of(readings: Readings) -> list[TrialRows]:
    """Return the trials, by name and class."""
    found: dict[tuple[int, int], list[int]] = {}
    for row, key in enumerate(zip(readings.trial_index.tolist(), readings.class_index.tolist(), strict=True)):
        found.setdefault(key, []).append(row)
    return [TrialRows(c, t, tuple(rows)) for (t, c), rows in sorted(found.items())]


Left = Mapping[int, Sequence[int]]
"""Rows that a trial has left, by setting; none is empty."""
NextSetting = Callable[[Float64Array, Left], int | None]
"""Returns the next setting under a belief, among those left; None: the trial has run out."""


def policy(name: str, setting: int | None, gain: ExpectedGain | None, uniform: UniformDraw) -> NextSetting:
    """Return a policy of :data:`POLICIES` over what a trial has left.

    Args:
        name: Which.
        setting: Of ``fixed``.
        gain: Of ``information_gain``.
        uniform: Chance.

    Raises:
        PerceptionError: No such policy.
    """
    if name == "recorded":
        return lambda _, left: min(left, key=lambda k: left[k][0], default=None)
    if name == "fixed" and setting is not None:
        return lambda _, left: setting if setting in left else None
    if name == "uniform":
        return lambda _, left: _any_of(left, uniform)
    if name == "information_gain" and gain is not None:
        return lambda belief, left: _most_telling(gain, belief, left)
    raise PerceptionError(f"no policy '{name}'; there are {', '.join(POLICIES)}")


def _any_of(left: Left, uniform: UniformDraw) -> int | None:
    among = sorted(left)
    return among[int(draw(np.full(len(among), 1.0 / len(among)), uniform()))] if among else None


def _most_telling(gain: ExpectedGain, belief: Float64Array, left: Left) -> int | None:
    if len(left) < 2:
        return next(iter(left), None)
    bits = dict(zip(gain.settings, gain.bits(belief).tolist(), strict=True))
    return max(sorted(left), key=lambda k: bits[k])


def judge(
    readings: Readings,
    trial: TrialRows,
    primitives: VectorPrimitives,
    following: NextSetting,
    *,
    likelihood: str,
    rule: StopRule,
    most: int,
) -> JudgedTrial | None:
    """Return what is made of a trial; None where the policy finds no reading in it.

    Args:
        readings: All of them.
        trial: Which.
        primitives: Learnt without it.
        following: Which setting next.
        likelihood: Method of task ``likelihood``.
        rule: When to stop.
        most: Readings after which the trial is undecided.
    """
    left: dict[int, list[int]] = {}
    for row in trial.rows:
        left.setdefault(int(readings.setting_index[row]), []).append(row)
    log_belief = bayes.flat_prior(len(readings.classes))
    flat = np.exp(log_belief)
    posteriors: list[Float64Array] = []
    gains: list[Float64Array] = []
    used: list[int] = []
    word = "continue"
    while word == "continue":
        setting = following(posteriors[-1] if posteriors else flat, left)
        if setting is None:
            word = "ran_out"
            break
        row = left[setting].pop(0)
        if not left[setting]:
            del left[setting]
        density = primitives.log_likelihood(readings.values[row], setting, model=likelihood)
        log_belief = bayes.update(log_belief, density)
        posteriors.append(bayes.posterior(log_belief))
        gains.append(gain_vector(posteriors[-1], flat))
        used.append(row)
        word = decide(rule, posteriors, gains, max_probes=most).word
    if not used:
        return None
    after = tuple(int(np.argmax(one)) == trial.class_index for one in posteriors)
    return JudgedTrial(trial, posteriors[-1], tuple(used), word, after)


def judge_all(
    readings: Readings,
    folds: Sequence[Fold],
    name: str,
    setting: int | None = None,
    *,
    likelihood: str,
    rule: StopRule,
    most: int,
    seed: int,
) -> Iterator[JudgedTrial]:
    """Yield every trial in which the policy finds a reading, judged by what the others taught.

    Args:
        readings: All of them.
        folds: What was learnt, and whom it judges.
        name: The policy, of :data:`POLICIES`.
        setting: Of the policy ``fixed``.
        likelihood: Method of task ``likelihood``.
        rule: When to stop.
        most: Readings after which a trial is undecided.
        seed: Of the policy's chance; each trial has its own.

    Raises:
        PerceptionError: No such policy.
        MethodError: No such likelihood.
    """
    by_name: dict[int, list[TrialRows]] = {}
    for trial in trials_of(readings):
        by_name.setdefault(trial.trial_index, []).append(trial)
    everywhere = tuple(range(len(readings.settings)))
    for fold in folds:
        gain = ExpectedGain.of(fold.primitives, everywhere) if name == "information_gain" else None
        for trial in (one for judged in fold.judged for one in by_name[judged]):
            rng = np.random.default_rng((seed, trial.trial_index, trial.class_index))
            found = judge(
                readings,
                trial,
                fold.primitives,
                policy(name, setting, gain, rng.random),
                likelihood=likelihood,
                rule=rule,
                most=most,
            )
            if found is not None:
                yield found
