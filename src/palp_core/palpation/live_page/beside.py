"""Figures that the live accuracy stands beside, with the command that gives them."""

from __future__ import annotations

from typing import Any

import msgspec

from palp_core.palpation.session.published import FIXED, HUMAN_STRATEGY_TEXT


class Figure(msgspec.Struct, frozen=True):
    """An accuracy that was found elsewhere: of what, and how large, in %."""

    what: str
    words: str


POLICIES_COMMAND = "python benchmarks/policies.py --sessions 20 --trials 20"
SOURCES = (
    ("this rig, simulated, 20 sessions", POLICIES_COMMAND),
    ("the paper", "Sornkarn and Nanayakkara, IEEE Transactions on Haptics"),
)

BESIDE = (
    Figure("this rig: best fixed position (16 mm)", "95.1 (90.8 to 99.4)"),
    Figure("this rig: as people do (Markov)", "86.2 (82.4 to 89.9)"),
    Figure("the paper: as people do", HUMAN_STRATEGY_TEXT.removesuffix(" %")),
    Figure("the paper: average of the fixed positions", f"{100 * FIXED['overall']:.1f}"),
)
"""Of the peak under the paper's stop rule; the README has the same figures."""


def other_protocol(given: dict[str, Any]) -> str:
    """Return what to say of a session that reads or stops otherwise than those figures'; "" of others."""
    usual = {
        "reading": "feature",
        "feature": "peak",
        "stop": "paper_guarded",
        "filter": "naive",
        "world": "paper",
    }
    other = [f"{name}:={given[name]}" for name, value in usual.items() if given.get(name, value) != value]
    if not other:
        return ""
    what = ", ".join(other)
    return f"they are of the peak under the paper's rule; this session has {what}: see docs/frontier.md"
