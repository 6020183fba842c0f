"""How the safety node stands, in words that say what to do."""

from __future__ import annotations

from typing import Any

import msgspec

SILENT_S = 1.0
"""A safety node beats a hundred times a second: one that is silent for so long is not to be relied on."""


class SafetyWord(msgspec.Struct, frozen=True):
    """What is said of safety: a word, how bad it is (``ok``, ``warn``, ``error``), cause and advice."""

    word: str
    level: str
    why: str = ""
    advice: str = ""
    tripped: bool = False


NOTHING_HEARD = SafetyWord("safety not heard yet", "unknown")


def standing(beat: dict[str, Any] | None, silent_s: float) -> SafetyWord:
    """Return how safety stands.

    Args:
        beat: The last ``SafetyBeat``; None before the first.
        silent_s: How long ago it came.
    """
    if beat is None:
        return NOTHING_HEARD
    if silent_s > SILENT_S:
        why = f"no heartbeat for {silent_s:.0f} s; stage and ring halt by themselves without it"
        return SafetyWord("safety is silent", "error", why, "palp logs safety")
    state, cause, text = beat["state"], beat["cause"], beat["text"]
    if state in ("stopping", "latched"):
        word = "stopping" if state == "stopping" else "STOPPED"
        advice = "when all is well, acknowledge (palp safety ack)"
        return SafetyWord(
            word, "error", ": ".join(part for part in (cause, text) if part), advice, tripped=True
        )
    if state == "starting":
        return SafetyWord("nothing may move yet", "warn", "all that is watched has to be heard first")
    word = "moving" if state == "moving" else "ready"
    return SafetyWord(word, "warn" if beat.get("warning", "") else "ok", beat.get("warning", ""))
