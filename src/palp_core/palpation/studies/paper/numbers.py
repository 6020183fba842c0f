"""What the paper published as numbers, and which of its statements those numbers carry.

Human counts follow from the percentages. The robot's counts were not published: each assumption about them is
named, and every statement is tested under each.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from palp_core.palpation.perception.statistics.anova import fisher

HUMAN_RIGHT = {"2": 24, "4": 17, "8": 17}
"""Of 30 at each depth: 80, 56.7 and 56.7 %."""
HUMAN_OF = 30
HUMAN_OVER_TRIALS = ((2, 1, 0.65), (2, 2, 0.80), (4, 3, 0.65), (8, 3, 0.65))
"""What the text says of Figure 4(a): depth in mm, trial, share; at 2 mm above 0.80 from the second trial on.

Three numbers, of which 65 % is none of six subjects' shares: the nearest are 4 of 6 (66.7 %), and 5 of 6 for
"above 80 %".
"""
HUMAN_2MM_RIGHT = (4, 5, 5, 5, 5)
"""Of six subjects, in each trial at 2 mm: the only counts that stay above 80 % and make 24 of 30."""

TABLE_3 = (2, 4, 8) * 5
"""Order of the training phase, depths in mm."""
TABLE_4 = (2, 8, 2, 4, 4, 8, 4, 2, 8, 4, 8, 4, 2, 8, 2)
"""Order of the estimation phase, depths in mm."""
TABLE_6 = ((0.1, 0.0), (0.2, 4.0), (0.3, 8.0), (0.4, 12.0), (0.5, 16.0))
"""Level of co-contraction and its ring position r_a in mm."""

PUBLISHED = {
    "human": {"2": 0.80, "4": 0.567, "8": 0.567, "overall": 0.65},
    "fixed": {"2": 0.80, "4": 0.60, "8": 0.60, "overall": 0.667},
    "human_strategy": {"overall": 0.90},
}

_FIXED = {"10 of 15 cells": (10, 15), "200 of 300 trials": (200, 300), "1000 of 1500 trials": (1000, 1500)}
_VARIED = (271, 300)
_CHI = "chi squared over 3 depths"


@dataclass(frozen=True)
class Statement:
    """A statement of the paper under an assumption about its counts."""

    text: str  # what the paper says
    assumption: str  # counts assumed; empty where they follow from what is published
    p: float  # p-value, as computed here
    test: str  # how
    holds: bool  # whether p at 0.05 agrees with the statement


def statements() -> list[Statement]:
    """Return every statement that can be tested from counts."""
    right = np.array(list(HUMAN_RIGHT.values()))
    human = (int(right.sum()), HUMAN_OF * len(right))
    trials = fisher((HUMAN_2MM_RIGHT[0], 6), (sum(HUMAN_2MM_RIGHT[1:]), 24))
    rows = [  # text, assumption, p, test, whether the paper states an influence
        ("human: depth has no significant influence", "", _chi_squared(right, HUMAN_OF), _CHI, False),
        (
            "human: the number of the trial has no significant influence",
            "at 2 mm 4 of 6, then 20 of 24",
            trials,
            "Fisher, first trial against the others",
            False,
        ),
    ]
    for name, counts in _FIXED.items():
        fixed, varied = f"fixed {name}", f"fixed {name}, varied 271 of 300"
        rows.append(("human against fixed: no difference", fixed, fisher(human, counts), "Fisher", False))
        better = fisher(_VARIED, counts)
        rows.append(("varied stiffness better than fixed", varied, better, "Fisher", True))
        if counts[1] % 3 == 0:
            third = counts[1] // 3
            p = _chi_squared(np.round(np.array([0.8, 0.6, 0.6]) * third).astype(int), third)
            rows.append(("fixed: depth has a significant influence", fixed, p, "chi squared", True))
    p = fisher(_VARIED, human)
    rows.append(("varied stiffness better than human", "varied 271 of 300", p, "Fisher", True))
    return [Statement(text, given, p, test, (p < 0.05) is states) for text, given, p, test, states in rows]


def _chi_squared(right: NDArray[np.int64], count: int) -> float:
    """Return the p-value that shares of equally many trials do not differ."""
    return float(stats.chi2_contingency(np.array([right, count - right])).pvalue)
