"""Compare two bags topic by topic: equal, equal within a tolerance, or the first difference."""

import math
from collections.abc import Callable, Collection
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec

from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.stream import decoder_for
from palp_core.graph.messages.schema_types import plain


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """Where two bags first differ on a topic; ``field`` is "" where one of the messages is not there."""

    place: int
    epoch: int
    sequence: int
    field: str
    a: Any
    b: Any

    def text(self) -> str:
        where = f"message {self.place} (epoch {self.epoch}, sequence {self.sequence})"
        return f"{where}: {self.field or 'message'}: {self.a} != {self.b}"


class TopicDiff(msgspec.Struct, kw_only=True):
    count_a: int = 0
    count_b: int = 0
    equal_count: int = 0
    close_count: int = 0  # of other bytes, but within the tolerance
    first: Difference | None = None


def diff_bags(
    a: str | Path,
    b: str | Path,
    topics: Collection[str] | None = None,
    *,
    tolerance: float = 0.0,
    relative: float = 0.0,
    ignore: Collection[str] = (),
) -> dict[str, TopicDiff]:
    """Compare the messages of each topic in their order, but for fields to ``ignore``, by name.

    Numbers may differ by ``tolerance`` in their own unit, or by ``relative`` as a part of the larger number.
    """

    def close(x: float, y: float) -> bool:
        return x == y or math.isclose(x, y, rel_tol=relative, abs_tol=tolerance)

    with Bag(a) as one, Bag(b) as two:
        if topics is None:
            topics = {*one.topics(), *two.topics()}
        found = {}
        for topic in sorted(topics):
            diff = found[topic] = TopicDiff()
            decoders: dict[int, Callable[[bytes], Any]] = {}
            for place, (x, y) in enumerate(zip_longest(one.recorded([topic]), two.recorded([topic]))):
                diff.count_a += x is not None
                diff.count_b += y is not None
                if diff.first is None:
                    diff.first = _compare(place, x, y, diff, close, ignore, decoders)
        return found


def _compare(
    place: int,
    x: RecordedMessage | None,
    y: RecordedMessage | None,
    diff: TopicDiff,
    close: Callable[[float, float], bool],
    ignore: Collection[str],
    decoders: dict[int, Callable[[bytes], Any]],
) -> Difference | None:
    known = x or y
    assert known is not None

    def differs(field: str, left: Any, right: Any) -> Difference:
        return Difference(
            place=place, epoch=known.stream.epoch, sequence=known.sequence, field=field, a=left, b=right
        )

    if x is None or y is None:
        return differs("", *("missing", "there") if x is None else ("there", "missing"))
    for field, left, right in (
        ("epoch", x.stream.epoch, y.stream.epoch),
        ("sequence", x.sequence, y.sequence),
    ):
        if left != right:
            return differs(field, left, right)
    if x.payload == y.payload and x.stream.encoding == y.stream.encoding:
        diff.equal_count += 1
        return None
    values = []
    for message in (x, y):
        if id(message.stream) not in decoders:
            decoders[id(message.stream)] = decoder_for(message.stream)
        values.append(decoders[id(message.stream)](message.payload))
    found = first_difference(values[0], values[1], close, ignore)
    if found is None:
        diff.close_count += 1
        return None
    field, left, right = found
    return differs(field or "value", left, right)


def first_difference(
    a: Any, b: Any, close: Callable[[float, float], bool], ignore: Collection[str] = (), path: str = ""
) -> tuple[str, Any, Any] | None:
    """Return path and values of the first field that differs, or None; NaN equals NaN."""
    if not path:
        a, b = plain(a), plain(b)
    if isinstance(a, dict) and isinstance(b, dict):
        for name in [*a, *(name for name in b if name not in a)]:
            if name in ignore:
                continue
            where = f"{path}.{name}" if path else str(name)
            if name not in a or name not in b:
                return where, a.get(name, "missing"), b.get(name, "missing")
            found = first_difference(a[name], b[name], close, ignore, where)
            if found is not None:
                return found
        return None
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return f"{path} (length)", len(a), len(b)
        for place, (x, y) in enumerate(zip(a, b, strict=True)):
            found = first_difference(x, y, close, ignore, f"{path}[{place}]")
            if found is not None:
                return found
        return None
    if _is_number(a) and _is_number(b):
        same = close(a, b) or (a != a and b != b)
        return None if same else (path, a, b)
    return None if type(a) is type(b) and a == b else (path, a, b)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
