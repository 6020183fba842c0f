"""What the muscles do, in words."""

from __future__ import annotations

from typing import Any

LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Of the level's index: the paper's five."""

FLOWING = ("ok", "streaming")
"""Conditions of a source whose blocks come."""

SILENT_S = 2.0
"""Blocks come many times a second."""
SILENT_FAST_S = 60.0
"""Of a graph that goes faster than anybody looks."""


def muscle_text(
    cocontraction: dict[str, Any] | None,
    report: dict[str, Any] | None,
    now_s: float | None = None,
    *,
    fast: bool = False,
) -> str:
    """Return the level of the latest peak, how many bursts there were, and what is wrong with the source.

    >>> muscle_words({"level": 2, "level_defined": True, "burst_count": 7, "value": [0.25]}, None)
    'co-contraction 0.25; level 0.3 at its latest peak (third of five); 7 bursts'
    >>> muscle_words(None, {"condition": "ok", "text": ""})
    'EMG comes; no co-contraction yet'
    """
    parts = []
    if cocontraction is not None:
        if cocontraction["value"]:
            parts.append(f"co-contraction {cocontraction['value'][-1]:.2f}")
        if cocontraction["level_defined"] and cocontraction["level"] < len(LEVELS):
            place = ("first", "second", "third", "fourth", "fifth")[cocontraction["level"]]
            parts.append(f"level {LEVELS[cocontraction['level']]:g} at its latest peak ({place} of five)")
        else:
            parts.append("no peak yet, so no level")
        count = cocontraction["burst_count"]
        parts.append(f"{count} burst{'s' if count != 1 else ''}")
        if now_s is not None:
            heard_s = cocontraction["stamp_ns"] / 1e9
            if now_s - heard_s > (SILENT_FAST_S if fast else SILENT_S):
                parts.append(f"silent since {heard_s:.0f} s on the graph's clock")
    if report is not None:
        if report["condition"] not in FLOWING:
            parts.append(": ".join(part for part in (report["condition"], report["text"]) if part))
        elif cocontraction is None:
            parts.append("EMG comes; no co-contraction yet")
    return "; ".join(parts) or "nothing heard yet"
