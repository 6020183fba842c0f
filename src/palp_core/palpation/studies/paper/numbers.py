"""What the paper published as numbers, and which of its statements those numbers carry.

Human counts follow from the percentages. The robot's counts were not published: each assumption about them is
named, and every statement is tested under each.
"""

from dataclasses import dataclass

import numpy as np
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
    depth = float(stats.chi2_contingency(np.array([right, HUMAN_OF - right])).pvalue)
    human = (int(right.sum()), HUMAN_OF * len(right))
    found = [
        Statement(
            "human: depth has no significant influence", "", depth, "chi squared over 3 depths", depth >= 0.05
        )
    ]
    p = fisher((HUMAN_2MM_RIGHT[0], 6), (sum(HUMAN_2MM_RIGHT[1:]), 24))
    found.append(
        Statement(
            "human: the number of the trial has no significant influence",
            "at 2 mm 4 of 6, then 20 of 24",
            p,
            "Fisher, first trial against the others",
            p >= 0.05,
        )
    )
    for name, counts in _FIXED.items():
        p = fisher(human, counts)
        found.append(Statement("human against fixed: no difference", f"fixed {name}", p, "Fisher", p >= 0.05))
        p = fisher(_VARIED, counts)
        found.append(
            Statement(
                "varied stiffness better than fixed",
                f"fixed {name}, varied 271 of 300",
                p,
                "Fisher",
                p < 0.05,
            )
        )
        if counts[1] % 3 == 0:
            third = counts[1] // 3
            by_depth = np.round(np.array([0.8, 0.6, 0.6]) * third).astype(int)
            p = float(stats.chi2_contingency(np.array([by_depth, third - by_depth])).pvalue)
            found.append(
                Statement(
                    "fixed: depth has a significant influence", f"fixed {name}", p, "chi squared", p < 0.05
                )
            )
    p = fisher(_VARIED, human)
    found.append(Statement("varied stiffness better than human", "varied 271 of 300", p, "Fisher", p < 0.05))
    return found
