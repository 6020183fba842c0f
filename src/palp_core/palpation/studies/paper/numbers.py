"""What the paper published as numbers. Human counts follow from its percentages."""

HUMAN_RIGHT = {"2": 24, "4": 17, "8": 17}
"""Of 30 at each depth: 80, 56.7 and 56.7 %."""
HUMAN_OF = 30
HUMAN_OVER_TRIALS = ((2, 1, 0.65), (2, 2, 0.80), (4, 3, 0.65), (8, 3, 0.65))
"""What the text says of Figure 4(a): depth in mm, trial, share; at 2 mm above 0.80 from the second trial on.

Three numbers, of which 65 % is none of six subjects' shares: the nearest are 4 of 6 (66.7 %), and 5 of 6 for
"above 80 %".
"""

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
