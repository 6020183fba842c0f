"""What difference between depths a session with so many people can find: simulated, not assumed.

One depth is easier than the others by a gap, subjects differ by a normal amount in logits, and the test is
the one-way analysis of variance of right and wrong over depths, as in the paper.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.special import expit, logit

SUBJECT_SD = 0.5
"""Spread of subjects, logits (assumed: nothing was published of single subjects)."""

WANTED = 0.8
LEVEL = 0.05
_GAPS = tuple(round(0.05 * step, 2) for step in range(1, 13))
_DRAWS = 2000
_SEED = 7


@dataclass(frozen=True)
class Power:
    subjects: int
    repeats: int  # trials per subject and depth
    share: float  # right answers on average
    # by how much one depth's share of right answers lies above the others', for which ``powers`` are
    gaps: tuple[float, ...]
    powers: tuple[float, ...]  # probability that the test finds it at 5 %
    false_alarms: float  # the same with no gap: the test's own level
    detectable: float | None  # least of these gaps found with 80 %; None: none of them is
    subject_sd: float = SUBJECT_SD  # spread of subjects, logits; assumed


def power_of(subjects: int, depths: int, repeats: int, share: float) -> Power:
    """Return the power of so many subjects with so many trials at each of so many depths."""
    share = min(max(share, 0.05), 0.95)
    gaps = tuple(
        gap for gap in _GAPS if share + gap * (depths - 1) / depths <= 0.98 and share - gap / depths >= 0.02
    )
    rng = np.random.default_rng(_SEED)
    powers = tuple(_power(subjects, depths, repeats, share, gap, rng) for gap in gaps)
    enough = [gap for gap, power in zip(gaps, powers, strict=True) if power >= WANTED]
    alarms = _power(subjects, depths, repeats, share, 0.0, rng)
    return Power(subjects, repeats, share, gaps, powers, alarms, min(enough, default=None))


def _power(
    subjects: int, depths: int, repeats: int, share: float, gap: float, rng: np.random.Generator
) -> float:
    means = np.full(depths, share - gap / depths)
    means[0] += gap
    spread = SUBJECT_SD * rng.standard_normal((_DRAWS, subjects, 1))
    chances = expit(logit(means) + spread)
    right = rng.binomial(repeats, chances).sum(axis=1).astype(np.float64)  # draws by depths
    count = subjects * repeats
    total = right.sum(axis=1)
    all_count = count * depths
    between = (right**2).sum(axis=1) / count - total**2 / all_count
    within = total - (right**2).sum(axis=1) / count  # the sum of squares of ones is their number
    degrees = all_count - depths
    with np.errstate(divide="ignore", invalid="ignore"):
        f = (between / (depths - 1)) / (within / degrees)
    critical = float(stats.f.ppf(1.0 - LEVEL, depths - 1, degrees)) if degrees > 0 else np.inf
    return float(np.mean(np.nan_to_num(f, nan=0.0) > critical))
