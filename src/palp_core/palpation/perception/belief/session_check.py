"""Do the trials of a session differ from its training by more than mountings do?

Each trial gives a few numbers that are 0 on average where nothing but the mounting differs: what its readings
are off by. The mean over a session's trials is held against its own law by Student's t. Phantoms count, not
trials, as those of a phantom may share all that it is off by; and trials may share the landing of a ring that
never moves. The spread is that of training's mountings, and of what classes differ by among themselves; where
every class was mounted once in training, what is stated beforehand counts as two mountings more.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.units import Float64Array

MISFIT = "misfit"
"""Name of the number that is how badly readings fit: not 0 on average but what training's mountings have."""
LEVEL = 0.05
"""Share of sessions that differ in nothing and are told all the same, at most."""
FIRST_LOOK, NEXT_LOOK = 30, 4
"""Trials after which a session is first held against training; then whenever they are so many times more."""
LOOK_P = 0.03
"""Probability below which a look tells: the looks of a session together are at most at :data:`LEVEL`."""
_LEAST = 3  # trials of a class, for it to count
_STATED = 2.0  # mountings that a stated spread counts for


class ClassTrials(msgspec.Struct):
    """Trials of a session that were taken for one class, added up.

    Attributes:
        phantoms: Trials of each phantom.
        felt: Sum of what they are off by, length l.
        squares: Sum of the squares of those.
        landing: Sum of what a landing of the ring adds to them.
        taught: Sums of what training's mountings are off by as the trials are judged, length l each.
    """

    phantoms: dict[str, int] = {}
    felt: list[float] = []
    squares: list[float] = []
    landing: list[float] = []
    taught: list[list[float]] = []


@dataclass(frozen=True, eq=False)
class Projected:
    """Trials that were taken for one class, as they are held against training.

    Attributes:
        names: Of the numbers.
        of: The class.
        felt: What they are off by, shape (n, l).
        landing: What a landing of the ring that is off by its spread adds, shape (l,).
        taught: What training's mountings of the class are off by from their mean, shape (mountings, l).
        mountings: Training's, of every class.
        stated: Variance of a mounting as stated beforehand; 0: nobody states it.
    """

    names: tuple[str, ...]
    of: int
    felt: Float64Array
    landing: Float64Array
    taught: Float64Array
    mountings: NDArray[np.int64]
    stated: float


class SessionTrials(msgspec.Struct):
    """What a session's trials differ by from its training, added up; plain data for a successor.

    Attributes:
        classes: By class.
        count: Trials.
        told: What was said of them; empty: nothing.
    """

    classes: dict[int, ClassTrials] = {}
    count: int = 0
    told: str = ""

    def add(self, one: Projected, phantom: str, row: int = 0) -> None:
        """Add a trial, of those that are projected together."""
        felt = one.felt[row]
        zero = [0.0] * len(felt)
        sums = self.classes.setdefault(one.of, ClassTrials({}, zero, zero, zero, [zero] * len(one.taught)))
        sums.phantoms[phantom] = sums.phantoms.get(phantom, 0) + 1
        sums.felt = (np.array(sums.felt) + felt).tolist()
        sums.squares = (np.array(sums.squares) + felt**2).tolist()
        sums.landing = (np.array(sums.landing) + one.landing).tolist()
        sums.taught = (np.array(sums.taught).reshape(one.taught.shape) + one.taught).tolist()
        self.count += 1

    @property
    def due(self) -> bool:
        """Whether to hold it against training now: after 30 trials, 120, 480 and so on."""
        at = FIRST_LOOK
        while at < self.count:
            at *= NEXT_LOOK
        return at == self.count


@dataclass(frozen=True)
class Shifted:
    """What a session's trials have on the whole and training had not.

    Attributes:
        name: Of the number that differs.
        scores: How many standard errors it is.
        p: Probability of as much or more of any, were there no difference.
    """

    name: str
    scores: float
    p: float


def shifted(trials: SessionTrials, last: Projected) -> Shifted | None:
    """Return by what the trials of a session differ most from training; None while there are too few.

    Args:
        trials: Of the session.
        last: One of them: what is known of training.
    """
    counted = {of: one for of, one in trials.classes.items() if sum(one.phantoms.values()) >= _LEAST}
    if not counted:
        return None
    sums = [_Sums.of(one, int(last.mountings[of]), last.names) for of, one in counted.items()]
    share = np.array([one.share for one in sums])[:, None]
    off = np.array([one.off for one in sums])
    mean = (share * off).sum(axis=0) / share.sum()
    squares = (share * (off - mean) ** 2).sum(axis=0) + sum(one.squares for one in sums)
    freedom = float(len(sums) - 1 + sum(one.freedom for one in sums))
    if last.stated and not any(one.freedom for one in sums):
        squares, freedom = squares + _STATED * last.stated, freedom + _STATED
    if not freedom:
        return None
    chance = (share**2 * np.array([one.chance for one in sums])).sum(axis=0) / share.sum() ** 2
    landing = (share * np.array([one.landing for one in sums])).sum(axis=0) / share.sum()
    variance = squares / freedom / share.sum() + chance + landing**2
    scores = mean / np.sqrt(np.maximum(variance, 1e-30))
    alone = np.where((off != 0.0).any(axis=0), 2.0 * scipy.special.stdtr(freedom, -np.abs(scores)), 1.0)
    worst = int(np.argmin(alone))
    several = int((off != 0.0).any(axis=0).sum())
    return Shifted(last.names[worst], float(scores[worst]), float(1.0 - (1.0 - alone[worst]) ** several))


@dataclass(frozen=True, eq=False)
class _Sums:
    """What the trials of one class come to.

    Attributes:
        off: What they are off by on average, shape (l,).
        share: One over how many mountings' variances their mean has.
        squares: Of training's mountings about their mean, shape (l,).
        freedom: How many of those are free.
        chance: Variance of the mean by what is new with each trial.
        landing: What a landing adds to the mean.
    """

    off: Float64Array
    share: float
    squares: Float64Array
    freedom: int
    chance: Float64Array
    landing: Float64Array

    @classmethod
    def of(cls, one: ClassTrials, mountings: int, names: tuple[str, ...]) -> _Sums:
        each = np.array(list(one.phantoms.values()), dtype=np.float64)
        count = each.sum()
        off, taught = np.array(one.felt) / count, np.array(one.taught).reshape(-1, len(one.felt)) / count
        chance = np.maximum(np.array(one.squares) / count - off**2, 0.0) / (count - 1.0)
        if MISFIT in names:  # how badly a mounting fits is known from training alone
            at = names.index(MISFIT)
            off[at] = off[at] - taught[:, at].mean() if len(taught) else 0.0
        return cls(
            off,
            1.0 / (1.0 / mountings + (each**2).sum() / count**2),
            ((taught - taught.mean(axis=0)) ** 2).sum(axis=0) if len(taught) else np.zeros(len(off)),
            max(len(taught) - 1, 0),
            chance,
            np.array(one.landing) / count,
        )
