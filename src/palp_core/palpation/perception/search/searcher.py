"""A search from lane to lane: what to sweep next, what the lanes say, and when it ends.

::

    searcher = Searcher(settings, answers)             # answers: a :class:`.LaneAnswers` for each ring
    while (lane := searcher.next_lane()) is not None:
        searcher.read(lane, torque_n_m)                # means of the bins, as :class:`.LaneRead` has them
    searcher.outcome()

All follows from the lanes read: ``Searcher(settings, answers, searcher.to_state())`` is the same search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.search.belief import (
    SearchBelief,
    Sums,
    add_lane,
    believe,
    log_ratio,
    prior_log_odds,
    sums_of,
)
from palp_core.palpation.perception.search.lanes import policy_of
from palp_core.palpation.perception.search.samples import BeadEstimate, Theta, estimate
from palp_core.palpation.perception.search.settings import Lane, LaneRead, SearchSettings
from palp_core.palpation.perception.search.templates import LaneAnswers, Level
from palp_core.units import Float64Array

Verdict = Literal["continue", "bead", "two_beads", "none", "undecided", "does_not_fit"]
_APART_M = 0.015  # of two beads: they do not overlap
_TURNS = 2  # of either bead given the other


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """What the lanes say so far."""

    verdict: Verdict  # ``continue`` while a lane may still change it
    beads: tuple[BeadEstimate, ...]  # what is known of one once it is likelier than none, and of a second
    probability: Float64Array  # of a bead in each cell of the square, shape (x, y)
    none: float  # probability that there is no bead
    second: float  # probability of a second bead, given one
    # probability of lanes that fit no better than these, if all is as trained: small values do not fit
    fit: float
    seconds: float  # of the rig, so far


class Searcher:
    """A search under way."""

    def __init__(
        self, settings: SearchSettings, answers: Sequence[LaneAnswers], state: Sequence[LaneRead] = ()
    ) -> None:
        self.settings = settings
        self.policy = policy_of(settings.policy)
        by_ring = {round(one.ring_m, 9): one for one in answers}
        if missing := [ring_m for ring_m in settings.rings_m if round(ring_m, 9) not in by_ring]:
            raise PerceptionError(f"no answers for rings at {missing} m; tabulate them")
        self._answers = by_ring
        self._reads: list[LaneRead] = list(state)
        self._belief = believe(settings, self.level_of, self._reads)
        self._outcome: SearchOutcome | None = None
        self._next: Lane | None = None

    def level_of(self, ring_m: float, number: int | None) -> Level:
        """Return a level of a ring, the one of no offsets for None."""
        answers = self._answers[round(ring_m, 9)]
        if number is None:
            number = answers.nearest(np.zeros(4))
        return _level(self.settings, answers, number)

    @property
    def belief(self) -> SearchBelief:
        """The map and the lanes that it is of."""
        return self._belief

    @property
    def seconds(self) -> float:
        """Seconds of the rig for the lanes read."""
        total, last = 0.0, None
        for one in self._reads:
            total, last = total + self.settings.lane_s(one.lane, last), one.lane
        return total

    def next_lane(self) -> Lane | None:
        """Return the lane to sweep next, or None once the search has ended."""
        return self._next if self.outcome().verdict == "continue" else None

    def read(self, lane: Lane, torque_n_m: Float64Array) -> None:
        """Take the means of a lane's bins, shape (b,), in the order of the sweep, with the rig's sign."""
        torque = np.asarray(torque_n_m, dtype=np.float64).tolist()
        one = LaneRead(lane.x_m, lane.forward, lane.ring_m, torque)
        self._belief = add_lane(self._belief, self.level_of, one)
        self._reads.append(one)
        self._outcome = None

    def to_state(self) -> list[LaneRead]:
        """Return what a replacement needs."""
        return list(self._reads)

    def outcome(self) -> SearchOutcome:
        """Return what the lanes say so far."""
        if self._outcome is None:
            self._outcome = self._judge()
        return self._outcome

    def _judge(self) -> SearchOutcome:
        settings, belief = self.settings, self._belief
        none, second, squares = belief.none, settings.second, _squares_of_none(belief)
        beads: tuple[BeadEstimate, ...] = ()
        if none < 0.5:
            first, squares = estimate(belief, belief.log_odds)
            beads = (first,)
            if self._time_over or self._known(beads) or self._fit(squares, 1) < settings.misfit:
                odds = second_log_odds(belief, first.mean)
                most = max(float(odds.max()), 0.0)
                share = float(np.exp(odds - most).sum())
                second = share / (share + float(np.exp(-most)))
                if second > 0.5:
                    beads, squares = _both(belief, first, odds)
        fit = self._fit(squares, len(beads))
        verdict = self._verdict(none, second, fit, beads, ends=self._time_over)
        self._next = None
        if verdict == "continue":
            self._next = self.policy.choose(belief, beads[0] if beads else None, self.level_of)
            if self._next is None:
                verdict = self._verdict(none, second, fit, beads, ends=True)
        return SearchOutcome(verdict, beads, belief.map, none, second, fit, self.seconds)

    @property
    def _time_over(self) -> bool:
        """Whether no further lane can end in time."""
        lanes = self._belief.lanes
        return (
            bool(lanes) and self.seconds + self.settings.lane_s(lanes[-1].lane, None) > self.settings.most_s
        )

    def _known(self, beads: tuple[BeadEstimate, ...]) -> bool:
        """Whether places and depths are known as well as is asked for."""
        settings = self.settings
        return all(
            one.place_sd_m <= settings.place_sd_m and one.depth_sd_m <= settings.depth_sd_m for one in beads
        )

    def _fit(self, squares: float, beads: int) -> float:
        """Return the probability that lanes fit no better, chi-squared, if all is as trained."""
        freedom = self.settings.bins * len(self._belief.lanes) - 3 * beads
        return float(scipy.special.chdtrc(freedom, squares)) if freedom > 0 else 1.0

    def _verdict(
        self, none: float, second: float, fit: float, beads: tuple[BeadEstimate, ...], *, ends: bool
    ) -> Verdict:
        settings = self.settings
        fits = fit >= settings.misfit
        if none > settings.sure:
            return "none" if fits else "does_not_fit"
        present = none < 1.0 - settings.sure and bool(beads)
        single = len(beads) == 1 and second <= settings.missed
        double = len(beads) == 2 and second > settings.sure
        if present and (single or double) and (ends or self._known(beads)):
            found: Verdict = "two_beads" if double else "bead"
            return found if fits else "does_not_fit"
        if ends:
            return "undecided" if fits else "does_not_fit"
        return "continue"


@lru_cache(maxsize=16)
def _level(settings: SearchSettings, answers: LaneAnswers, number: int) -> Level:
    return Level(settings, answers, number)


def _squares_of_none(belief: SearchBelief) -> float:
    """Return r' S^-1 r without a bead, the offsets integrated out."""
    if belief.sums is None:
        return 0.0
    total = 0.0
    for one in belief.lanes:
        rest = one.level.white @ one.rest_n_m(one.columns(belief.offset_count))
        total += float(rest @ rest)
    return total - float(belief.sums.a @ np.linalg.solve(belief.sums.m, belief.sums.a))


def second_log_odds(belief: SearchBelief, first: Theta) -> Float64Array:
    """Return log P(a second bead in the cell) / P(no second), given a first one, shape (x, d, y).

    The first one's place and depth are offsets, too, within a few of the cells' lengths.
    """
    settings, count = belief.settings, belief.offset_count
    sums: Sums | None = None
    steps = np.array([0.5e-3, 0.5e-3, 0.25e-3])
    beads = np.concatenate([first[None], first + np.diag(steps), first - np.diag(steps)])
    for one in belief.lanes:
        bins_m = settings.bins_m
        x_m, y_m, depth_m = beads[:, 0] - one.lane.x_m, one.way * beads[:, 1], beads[:, 2]
        felt = one.level.signals.at(x_m, y_m, depth_m, bins_m)[..., 0]
        slope = one.level.slopes.at(x_m[:1], y_m[:1], depth_m[:1], bins_m)[0]
        columns = one.columns(count, slope)
        rest = one.rest_n_m(columns) - felt[0]
        of_first = (felt[1:4] - felt[4:]).T  # by 1 mm, 1 mm and 0.5 mm
        own = sums_of(one, rest, np.concatenate([columns, of_first], axis=1))
        sums = own if sums is None else sums + own
    assert sums is not None
    share = min(max(settings.second, 1e-6), 1.0 - 1e-6)
    odds = prior_log_odds(settings, belief.lanes[-1].level, share)
    odds += log_ratio(sums, settings.amplitude_sd)
    away_m = np.hypot(settings.cells_m[:, None] - first[0], settings.cells_m - first[1])
    return np.where((away_m < _APART_M)[:, None, :], -np.inf, odds)


def _both(
    belief: SearchBelief, first: BeadEstimate, odds: Float64Array
) -> tuple[tuple[BeadEstimate, ...], float]:
    """Return two beads, each with its intervals given the other, and the least r' S^-1 r."""
    other, squares = estimate(belief, odds, (first.mean,))
    for _ in range(_TURNS):
        near = _around(belief, first.mean)
        first, _ = estimate(belief, near, (other.mean,))
        other, squares = estimate(belief, _around(belief, other.mean), (first.mean,))
    return (first, other), squares


def _around(belief: SearchBelief, theta: Theta) -> Float64Array:
    """Return a map (x, d, y) with its one mode at a bead."""
    settings = belief.settings
    found = np.full(belief.log_odds.shape, -np.inf)
    i, j = (int(np.argmin(np.abs(settings.cells_m - place))) for place in theta[:2])
    found[i, int(np.argmin(np.abs(np.array(settings.depths_m) - theta[2]))), j] = 0.0
    return found
