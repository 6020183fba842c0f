"""The state of the safety node, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from palp_core.graph.discovery.troubles import Trouble

SILENT_S = 1.0
"""A safety node beats a hundred times a second: one that is silent for so long is not to be relied on."""


class SafetyStatus(msgspec.Struct, frozen=True):
    """The state of safety: a word, how bad it is (``ok``, ``warn``, ``error``), cause and advice."""

    word: str
    level: str
    why: str = ""
    advice: str = ""
    tripped: bool = False


MOVING = "moving"
OPERATOR = "operator"
"""Cause of a stop on request."""
BY_OPERATOR = "nothing moves, all nodes go on; on request"
STOPPED_ON_PURPOSE = "stopped on purpose"
NO_BEAT = SafetyStatus("no heartbeat of safety yet", "unknown")
OVER = SafetyStatus("over", "unknown", "the graph has ended; no safety node watches the rig any more")


def safety_status(beat: dict[str, Any] | None, silent_s: float) -> SafetyStatus:
    if beat is None:
        return NO_BEAT
    if silent_s > SILENT_S:
        why = f"no heartbeat for {silent_s:.0f} s; stage and ring halt by themselves without it"
        return SafetyStatus("safety is silent", "error", why, "palp logs safety")
    state, cause, text = beat["state"], beat["cause"], beat["text"]
    if state in ("stopping", "latched"):
        word = "stopping" if state == "stopping" else "STOPPED"
        advice = "when all is well, acknowledge (palp safety ack)"
        why = ": ".join(part for part in (BY_OPERATOR if cause == OPERATOR else cause, text) if part)
        return SafetyStatus(word, "error", why, advice, tripped=True)
    if state == "starting":
        return SafetyStatus("nothing may move yet", "warn", "every watched node has to report first")
    word = MOVING if state == "moving" else "ready"
    return SafetyStatus(word, "warn" if beat.get("warning", "") else "ok", beat.get("warning", ""))


def stop_text(reply: Mapping[str, Any]) -> str:
    """Return what came of a press on STOP.

    >>> stop_text({"state": "latched", "cause": "operator"})
    'latched: operator'
    >>> stop_text({"state": "latched", "cause": "stale"})
    'latched: it was stopped already when you pressed (stale)'
    """
    if reply["cause"] == OPERATOR:
        return f"{reply['state']}: {reply['cause']}"
    return f"{reply['state']}: it was stopped already when you pressed ({reply['cause']})"


def acknowledge_text(reply: Mapping[str, Any]) -> str:
    """Return what came of an acknowledgement, and what comes next.

    >>> acknowledge_text({"done": False, "state": "latched", "text": "the stop is not confirmed yet"})
    'latched: not acknowledged: the stop is not confirmed yet'
    >>> acknowledge_text({"done": True, "state": "starting", "text": "the rig goes on by itself"})
    'acknowledged: the rig goes on by itself'
    """
    parts = ("acknowledged",) if reply["done"] else (reply["state"], "not acknowledged")
    return ": ".join(part for part in (*parts, reply["text"]) if part)


def heading(troubles: Sequence[Trouble]) -> tuple[str, list[Trouble]] | None:
    """Return what heads a page while somebody's stop holds, and what else is wrong; None while none does.

    Who stopped it, and what to do, is next to the button.
    """
    rest = [one for one in troubles if not one.text.startswith(f"tripped: {OPERATOR}")]
    return (STOPPED_ON_PURPOSE, rest) if len(rest) < len(troubles) else None
