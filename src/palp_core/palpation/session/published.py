"""Published figures that a session is shown beside.

N. Sornkarn and T. Nanayakkara, "Can a soft robotic probe use stiffness control like a human finger to improve
efficacy of haptic perception?", IEEE Transactions on Haptics.
"""

FIXED = {"2": 0.80, "4": 0.60, "8": 0.60, "overall": 0.667}
"""Accuracy at a fixed ring position by depth in mm, average over the five positions."""

HUMAN_STRATEGY_TEXT = "slightly above 90 %"
