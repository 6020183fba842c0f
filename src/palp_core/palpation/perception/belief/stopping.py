"""When to stop probing: rules over the beliefs and gains so far, and the verdict; task ``stop``.

The published rule stops when the correlation distance between successive gain vectors falls below T = 0.0005.
That distance has cases without a value, and it cannot see a belief that doubles along the same direction;
each case is named here. Every rule has the one method :meth:`StopRule.converged`, to be asked after each
probe.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal, Protocol

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.methods import find, method
from palp_core.units import Float64Array

_FEWEST = 3  # classes; the correlation of two numbers is 1 or -1
_LEAST_SPREAD = 1e-12  # nats; a gain vector that varies less is rounding noise about "nothing gained"


@dataclass(frozen=True)
class StopState:
    """What a rule says after a probe.

    Attributes:
        gamma: Correlation distance of the last two gain vectors, 0 to 2; 0.0 where not defined.
        gamma_defined: Whether there is such a distance.
        converged: Whether to stop here.
    """

    gamma: float
    gamma_defined: bool
    converged: bool


@dataclass(frozen=True)
class Verdict:
    """Whether a trial goes on, and its estimate.

    Attributes:
        word: ``continue``, ``decided``, or ``undecided`` when the probes ran out.
        class_index: Class with the largest posterior (the first of equals), whatever the word.
        probe_count: Probes so far.
        state: The rule's state.
    """

    word: Literal["continue", "decided", "undecided"]
    class_index: int
    probe_count: int
    state: StopState


class StopRule(Protocol):
    """Anything that says from the history of one trial whether to stop."""

    def converged(self, posteriors: Sequence[Float64Array], gains: Sequence[Float64Array]) -> StopState:
        """Return the state after the last probe.

        Args:
            posteriors: P_1 .. P_t, each shape (m,); the prior P_0 is not among them.
            gains: G_1 .. G_t of eq. (8), each shape (m,).
        """
        ...


def total_variation(first: Float64Array, second: Float64Array) -> float:
    """Return half the summed absolute difference of two distributions, 0 to 1."""
    return float(0.5 * np.abs(first - second).sum())


def too_few(class_count: int) -> PerceptionError:
    """Return the error of a correlation distance over fewer than three classes."""
    return PerceptionError(
        f"the correlation distance of {class_count} classes is 0 or 2 whatever was felt; "
        "use the stop rule 'posterior_threshold' or 'fixed_number'"
    )


def correlation_distance(first: Float64Array, second: Float64Array) -> float | None:
    """Return 1 minus Pearson's correlation of two gain vectors, or None where it has no value.

    It has none when a vector does not vary over the classes: nothing was gained, as at t = 0 or after a probe
    that tells nothing.

    Args:
        first: Gain vector, nats, shape (m,).
        second: Gain vector, nats, shape (m,).

    Raises:
        PerceptionError: There are fewer than three classes: the distance could only be 0 or 2.
    """
    if first.shape != second.shape:
        raise PerceptionError(f"gain vectors have shapes {first.shape} and {second.shape}")
    if first.size < _FEWEST:
        raise too_few(first.size)
    a, b = first - first.mean(), second - second.mean()
    if np.abs(a).max() < _LEAST_SPREAD or np.abs(b).max() < _LEAST_SPREAD:
        return None
    cosine = (a / np.linalg.norm(a)) @ (b / np.linalg.norm(b))
    return float(np.clip(1.0 - cosine, 0.0, 2.0))


def _last_gamma(gains: Sequence[Float64Array]) -> float | None:
    """Return the distance of the last two gains; none before the second probe: G_0 = 0 does not vary."""
    previous = gains[-2] if len(gains) > 1 else np.zeros_like(gains[-1])
    return correlation_distance(previous, gains[-1])


@method(
    task="stop",
    name="paper_verbatim",
    cost_s=4e-5,
    evidence="tests/palpation/perception/belief/test_stopping.py",
    fails="a belief that grows along one direction has distance 0 and stops early; two classes",
    survivor="paper_guarded",
)
@dataclass(frozen=True)
class PaperVerbatim:
    """Stop when the correlation distance is not above ``threshold``; an undefined distance does not stop.

    Attributes:
        threshold: T, dimensionless; 0.0005 as published.
    """

    threshold: float = 0.0005

    def converged(self, posteriors: Sequence[Float64Array], gains: Sequence[Float64Array]) -> StopState:
        gamma = _last_gamma(gains)
        if gamma is None:
            return StopState(0.0, gamma_defined=False, converged=False)
        return StopState(gamma, gamma_defined=True, converged=gamma <= self.threshold)


@method(
    task="stop",
    name="paper_guarded",
    cost_s=5e-5,
    evidence="tests/palpation/perception/belief/test_stopping.py",
    fails="probes that share an error agree with each other and stop it, however wrong; two classes",
    survivor="posterior_threshold",
)
@dataclass(frozen=True)
class PaperGuarded:
    """As :class:`PaperVerbatim`, and the posterior must have settled too.

    Attributes:
        threshold: T, dimensionless; 0.0005 as published.
        settled: Largest total variation between the last two posteriors, 0 to 1 (assumed).
    """

    threshold: float = 0.0005
    settled: float = 0.05

    def converged(self, posteriors: Sequence[Float64Array], gains: Sequence[Float64Array]) -> StopState:
        state = PaperVerbatim(self.threshold).converged(posteriors, gains)
        if not state.converged:
            return state
        still = total_variation(posteriors[-2], posteriors[-1]) <= self.settled
        return StopState(state.gamma, gamma_defined=True, converged=still)


@method(
    task="stop",
    name="posterior_threshold",
    cost_s=1e-5,
    evidence="tests/palpation/perception/belief/test_stopping.py",
    fails="over-confident likelihoods pass any level at once",
    survivor="fixed_number",
)
@dataclass(frozen=True)
class PosteriorThreshold:
    """Stop when one class is probable enough.

    Attributes:
        level: Posterior probability to reach (assumed).
    """

    level: float = 0.95

    def converged(self, posteriors: Sequence[Float64Array], gains: Sequence[Float64Array]) -> StopState:
        return StopState(0.0, gamma_defined=False, converged=bool(posteriors[-1].max() >= self.level))


@method(
    task="stop",
    name="fixed_number",
    cost_s=1e-6,
    evidence="tests/palpation/perception/belief/test_stopping.py",
    fails="easy trials take as many probes as hard ones",
)
@dataclass(frozen=True)
class FixedNumber:
    """Stop after a number of probes.

    Attributes:
        count: That number (assumed: 5, within which most published trials ended).
    """

    count: int = 5

    def converged(self, posteriors: Sequence[Float64Array], gains: Sequence[Float64Array]) -> StopState:
        return StopState(0.0, gamma_defined=False, converged=len(posteriors) >= self.count)


def stop_rule(name: str, value: float = 0.0, *, max_probes: int | None = None) -> StopRule:
    """Return a declared rule by name, as a node's parameters give it.

    Args:
        name: Of task ``stop``.
        value: The rule's own number (T, a probability, a count of probes); 0 for its default.
        max_probes: Probes after which a trial ends undecided; None: not told.

    Raises:
        MethodError: No such rule.
        PerceptionError: The rule has no use for such a number, or never gets as many probes as it wants.
    """
    kind = find("stop", name).target
    own = fields(kind)[0]
    whole = isinstance(own.default, int)
    if (
        not 0.0 <= value < np.inf
        or (whole and value != int(value))
        or (name == "posterior_threshold" and value > 1.0)
    ):
        raise PerceptionError(f"the stop rule '{name}' cannot have {own.name} = {value:g}")
    rule: StopRule = kind() if value == 0.0 else kind(**{own.name: int(value) if whole else value})
    wanted = rule.count if isinstance(rule, FixedNumber) else 1
    if max_probes is not None and max_probes < wanted:
        raise PerceptionError(
            f"max_probes is {max_probes}, but the stop rule '{name}' wants {wanted}; raise it"
        )
    return rule


def require_classes(name: str, class_count: int) -> None:
    """Refuse a rule that cannot decide among so few classes, before anything was felt.

    Args:
        name: Of task ``stop``.
        class_count: Number of classes a belief is about.

    Raises:
        MethodError: No such rule.
        PerceptionError: It goes by the correlation distance, and there are fewer than three classes.
    """
    if class_count < _FEWEST and find("stop", name).target in (PaperVerbatim, PaperGuarded):
        raise too_few(class_count)


def decide(
    rule: StopRule,
    posteriors: Sequence[Float64Array],
    gains: Sequence[Float64Array],
    *,
    max_probes: int,
) -> Verdict:
    """Return the verdict after the last probe of a trial.

    Args:
        rule: The stop rule.
        posteriors: P_1 .. P_t.
        gains: G_1 .. G_t.
        max_probes: Probes after which a trial without convergence is ``undecided``.

    Raises:
        PerceptionError: There is no probe yet, or the two histories differ in length.
    """
    if not posteriors or len(posteriors) != len(gains):
        raise PerceptionError(
            f"a verdict needs equal histories, not {len(posteriors)} and {len(gains)} probes"
        )
    state = rule.converged(posteriors, gains)
    best = int(np.argmax(posteriors[-1]))
    if state.converged:
        return Verdict("decided", best, len(posteriors), state)
    if len(posteriors) >= max_probes:
        return Verdict("undecided", best, len(posteriors), state)
    return Verdict("continue", best, len(posteriors), state)
