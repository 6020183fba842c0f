"""Rules that end a trial, from the beliefs so far, and the verdict; task ``stop``.

The published rule stops when the correlation distance between successive gain vectors falls below T = 0.0005.
That distance has cases without a value, and it cannot see a belief that doubles along the same direction;
each case is named here.

Arrays may have leading dimensions, one entry per trial: many trials are judged by the same lines as one. A
rule is one class here, and a row of the register.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.methods import find
from palp_core.units import Float64Array

_FEWEST = 3  # classes; the correlation of two numbers is 1 or -1
_LEAST_SPREAD = 1e-12  # nats; a gain vector that varies less is rounding noise about "nothing gained"


@dataclass(frozen=True, eq=False)
class BeliefStep:
    """What a rule sees: beliefs and gains after a probe and before it."""

    posterior: Float64Array  # P_t, shape (..., m)
    before: Float64Array  # P_{t-1}, shape (..., m); at the first probe the prior, or NaN without one
    gain: Float64Array  # G_t of eq. (8), nats, shape (..., m).
    gain_before: Float64Array  # G_{t-1}, shape (..., m); zero at the first probe
    probe_count: int  # t, the same for all trials

    @classmethod
    def over(
        cls, prior: Float64Array, posterior: Float64Array, before: Float64Array, probe_count: int
    ) -> BeliefStep:
        """Return the step from one belief to the next, with the gains over the prior P_0, shape (m,)."""
        return cls(
            posterior,
            before,
            scipy.special.rel_entr(posterior, prior),
            scipy.special.rel_entr(before, prior),
            probe_count,
        )

    @classmethod
    def last(cls, posteriors: Sequence[Float64Array], gains: Sequence[Float64Array]) -> BeliefStep:
        """Return the latest step of a history P_1 .. P_t and G_1 .. G_t, each shape (..., m)."""
        unknown, nothing = np.full_like(posteriors[-1], np.nan), np.zeros_like(gains[-1])
        (*_, before, after), (*_, gain_before, gain) = [unknown, *posteriors], [nothing, *gains]
        return cls(after, before, gain, gain_before, len(posteriors))

    @cached_property
    def gamma(self) -> Float64Array:
        """Correlation distance of the last two gain vectors, shape (...); NaN where it is not defined."""
        return correlation_distance(self.gain_before, self.gain)


@dataclass(frozen=True, eq=False)
class StopState:
    """What a rule says after a probe."""

    # Correlation distance of the last two gain vectors, 0 to 2, shape (...); NaN where it is not defined, or
    # the rule does not use it
    gamma: Float64Array
    converged: NDArray[np.bool_]  # Whether to stop here, shape (...)


@dataclass(frozen=True)
class Verdict:
    """Whether a trial goes on, and its estimate."""

    # `continue`, `decided`, `undecided` when the probes ran out, or `dropped`, which no rule says, when a
    # reading has nothing to be compared with
    word: Literal["continue", "decided", "undecided", "dropped"]
    class_index: int  # Class with the largest posterior (the first of equals), whatever the word
    probe_count: int  # Probes so far
    gamma: float  # The rule's correlation distance, 0 to 2; 0.0 where not defined
    gamma_defined: bool  # Whether there is such a distance


class StopRule(ABC):
    """Says after each probe whether to stop; a frozen dataclass, first the rule's own number."""

    largest: ClassVar[float] = np.inf  # Largest value that its own number may have
    # Whether it may be asked before a probe is over: it uses the belief alone
    within_a_sweep: ClassVar[bool] = False

    @property
    def fewest_probes(self) -> int:
        """Probes before which it never stops."""
        return 1

    @abstractmethod
    def check(self, step: BeliefStep) -> StopState:
        """Return what it says after a probe."""


def total_variation(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return half the summed absolute difference of distributions (..., m), 0 to 1, shape (...)."""
    return np.asarray(0.5 * np.abs(first - second).sum(axis=-1))


def correlation_distance(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return 1 minus Pearson's correlation of gain vectors, shape (...), NaN where it has no value.

    It has none when a vector does not vary over the classes: nothing was gained, as at t = 0 or after a probe
    that shows nothing.
    """
    if first.shape != second.shape:
        raise PerceptionError(f"gain vectors have shapes {first.shape} and {second.shape}")
    if first.shape[-1] < _FEWEST:
        raise PerceptionError(
            f"the correlation distance of {first.shape[-1]} classes is 0 or 2 whatever was felt; "
            "use the stop rule 'posterior_threshold' or 'fixed_number'"
        )
    a = first - first.mean(axis=-1, keepdims=True)
    b = second - second.mean(axis=-1, keepdims=True)
    flat = (np.abs(a).max(axis=-1) < _LEAST_SPREAD) | (np.abs(b).max(axis=-1) < _LEAST_SPREAD)
    cosine = _dot(_direction(a, flat), _direction(b, flat))
    return np.where(flat, np.nan, np.clip(1.0 - cosine, 0.0, 2.0))


def _direction(vector: Float64Array, flat: NDArray[np.bool_]) -> Float64Array:
    length = np.where(flat, 1.0, np.sqrt(_dot(vector, vector)))
    return np.asarray(vector / length[..., None])


def _dot(first: Float64Array, second: Float64Array) -> Float64Array:
    return np.asarray((first[..., None, :] @ second[..., :, None])[..., 0, 0])


@dataclass(frozen=True)
class PaperVerbatim(StopRule):
    """Stop when the correlation distance is not above ``threshold``; an undefined distance does not stop."""

    threshold: float = 0.0005  # T, dimensionless; 0.0005 as published

    def check(self, step: BeliefStep) -> StopState:
        return StopState(step.gamma, step.gamma <= self.threshold)


@dataclass(frozen=True)
class PaperGuarded(StopRule):
    """As :class:`PaperVerbatim`, and the posterior must have settled too."""

    threshold: float = 0.0005  # T, dimensionless; 0.0005 as published
    settled: float = 0.05  # Largest total variation between the last two posteriors, 0 to 1 (assumed)

    def check(self, step: BeliefStep) -> StopState:
        still = total_variation(step.posterior, step.before) <= self.settled
        return StopState(step.gamma, (step.gamma <= self.threshold) & still)


@dataclass(frozen=True)
class PosteriorThreshold(StopRule):
    """Stop when one class is probable enough."""

    largest: ClassVar[float] = 1.0
    within_a_sweep: ClassVar[bool] = True
    level: float = 0.95  # Posterior probability to reach (assumed)

    def check(self, step: BeliefStep) -> StopState:
        return _apart_from_gamma(step.posterior.max(axis=-1) >= self.level)


@dataclass(frozen=True)
class FixedNumber(StopRule):
    """Stop after a number of probes."""

    count: int = 5  # That number (assumed: 5, within which most published trials ended)

    @property
    def fewest_probes(self) -> int:
        return self.count

    def check(self, step: BeliefStep) -> StopState:
        return _apart_from_gamma(np.full(step.posterior.shape[:-1], step.probe_count >= self.count))


def _apart_from_gamma(converged: NDArray[np.bool_]) -> StopState:
    """Return the state of a rule that does not use the correlation distance."""
    return StopState(np.full(np.shape(converged), np.nan), np.asarray(converged))


def stop_rule(name: str, value: float = 0.0, *, max_probes: int | None = None) -> StopRule:
    """Return a declared rule by name, as a node's parameters give it.

    >>> import numpy as np
    >>> rule, belief, no_gain = stop_rule("posterior_threshold", 0.9), np.array([0.95, 0.05]), np.zeros(2)
    >>> decide(rule, [belief], [no_gain], max_probes=10).word
    'decided'

    Args:
        name: Of task ``stop``.
        value: The rule's own number (T, a probability, a count of probes); 0 for its default.
        max_probes: Probes after which a trial ends undecided; None: no limit.

    Raises:
        MethodError: No such rule.
        PerceptionError: The rule has no use for such a number, or never gets as many probes as it wants.
    """
    kind: type[StopRule] = find("stop", name).target
    own = fields(kind)[0]  # type: ignore[arg-type]
    whole = isinstance(own.default, int)
    if not 0.0 <= value < np.inf or (whole and value != int(value)) or value > kind.largest:
        raise PerceptionError(f"the stop rule '{name}' cannot have {own.name} = {value:g}")
    rule = kind() if value == 0.0 else kind(**{own.name: int(value) if whole else value})
    if max_probes is not None and max_probes < rule.fewest_probes:
        raise PerceptionError(
            f"max_probes is {max_probes}, but the stop rule '{name}' wants {rule.fewest_probes}; raise it"
        )
    return rule


def require_classes(name: str, class_count: int) -> None:
    """Refuse a rule that cannot decide among so few classes, before anything was felt."""
    flat, nothing = np.full(class_count, 1.0 / class_count), np.zeros(class_count)
    stop_rule(name).check(BeliefStep(flat, flat, nothing, nothing, 1))


def decide(
    rule: StopRule,
    posteriors: Sequence[Float64Array],
    gains: Sequence[Float64Array],
    *,
    max_probes: int,
) -> Verdict:
    """Return the verdict after the last probe of a trial."""
    if not posteriors or len(posteriors) != len(gains):
        raise PerceptionError(
            f"a verdict needs equal histories, not {len(posteriors)} and {len(gains)} probes"
        )
    state, count = rule.check(BeliefStep.last(posteriors, gains)), len(posteriors)
    word: Literal["continue", "decided", "undecided"] = "continue"
    if state.converged:
        word = "decided"
    elif count >= max_probes:
        word = "undecided"
    defined = not np.isnan(state.gamma)
    return Verdict(
        word, int(np.argmax(posteriors[-1])), count, float(state.gamma) if defined else 0.0, defined
    )
