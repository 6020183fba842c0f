"""Compare what two nodes publish that do the same work, message by message."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import msgspec
import numpy as np

from palp_core.counted import counted
from palp_core.graph.messages.frame import Frame, Kind, parse

MOST_WAITING = 100_000


class ShadowComparison:
    """Two streams of frames, matched by topic and sequence."""

    def __init__(self, published: Mapping[str, int], arrays: Mapping[str, Collection[str]]) -> None:
        self._arrays = arrays
        self._published = dict(published)
        self._waiting: tuple[dict[tuple[str, int], bytes], ...] = ({}, {})
        self._equal: dict[str, int] = {}
        self._differing: dict[str, int] = {}
        self._largest: dict[str, float] = {}
        self._first: dict[str, Any] | None = None

    def old(self, raw: bytes) -> None:
        """Take a frame of the old node, which readers receive."""
        self._take(raw, 0)

    def new(self, raw: bytes) -> None:
        """Take a frame of the new node, which readers do not receive."""
        self._take(raw, 1)

    def _take(self, raw: bytes, side: int) -> None:
        frame = parse(raw)
        hidden = frame.topic.rpartition("/")[2].startswith("_")
        if frame.kind != Kind.DATA or hidden or frame.sequence <= self._published.get(frame.topic, 0):
            return
        key, payload = (frame.topic, frame.sequence), bytes(frame.payload)
        other = self._waiting[1 - side].pop(key, None)
        if other is None:
            if len(self._waiting[side]) < MOST_WAITING:
                self._waiting[side][key] = payload
        elif other == payload:
            self._equal[frame.topic] = self._equal.get(frame.topic, 0) + 1
        else:
            self._differ(frame, *((payload, other) if side == 0 else (other, payload)))

    def _differ(self, frame: Frame, old: bytes, new: bytes) -> None:
        self._differing[frame.topic] = self._differing.get(frame.topic, 0) + 1
        ours, theirs = (msgspec.msgpack.decode(payload) for payload in (old, new))
        arrays = self._arrays.get(frame.topic, ())
        for name, difference in _differences(ours, theirs, arrays):
            key = f"{frame.topic}.{name}"
            self._largest[key] = max(self._largest.get(key, 0.0), difference)
        if self._first is None:
            self._first = {
                "topic": frame.topic,
                "sequence": frame.sequence,
                "stamp_s": frame.stamp_ns / 1e9,
                "old": _shown(ours, arrays),
                "new": _shown(theirs, arrays),
            }

    def report(self) -> dict[str, Any]:
        """Return how often and how the two differ, for a machine, and as ``text``."""
        equal, differing = sum(self._equal.values()), sum(self._differing.values())
        only_old, only_new = (len(waiting) for waiting in self._waiting)
        text = f"{counted(equal + differing, 'message')} of both compared: {equal} equal, {differing} differ"
        if self._largest:
            text += "; largest differences: " + ", ".join(
                f"{name} {value:.6g}" for name, value in self._largest.items()
            )
        if only_old or only_new:
            text += f"; {only_old} only of the old node, {only_new} only of the new one"
        return {
            "compared": equal + differing,
            "equal": equal,
            "differing": differing,
            "only_old": only_old,
            "only_new": only_new,
            "largest": self._largest,
            "first_difference": self._first or {},
            "text": text,
        }


def _differences(old: Any, new: Any, arrays: Collection[str]) -> Iterator[tuple[str, float]]:
    """Yield the fields of two messages that differ, and by how much (infinity where that has no number)."""
    for name in {**old, **new}:
        ours, theirs = old.get(name), new.get(name)
        if ours == theirs:
            continue
        if name in arrays and len(ours) == len(theirs):
            yield name, float(np.max(np.abs(np.frombuffer(ours) - np.frombuffer(theirs))))
            continue
        numbers = isinstance(ours, int | float) and isinstance(theirs, int | float)
        yield name, abs(float(ours) - float(theirs)) if numbers else float("inf")


def _shown(message: Any, arrays: Collection[str]) -> dict[str, Any]:
    shown = {}
    for name, value in message.items():
        if name in arrays:
            shown[name] = np.frombuffer(value).tolist()
        else:
            shown[name] = value.hex() if isinstance(value, bytes) else value
    return shown
