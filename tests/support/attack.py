"""Requests and messages of a stranger who means harm: random bytes, random maps, and almost right ones."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgpack

NUMBERS: Sequence[Any] = (0, -1, 2**63, 2**64 - 1, -(2**63), float("nan"), float("inf"), -1e308)
TEXTS: Sequence[Any] = ("", "a", "x" * 200, "\0", "../../etc/passwd", "/", "/graph/", "é" * 100)
OTHERS: Sequence[Any] = (None, True, b"", b"\xff\xfe", b"x" * 300, [], [[]], [0] * 50, {}, {"a": {}}, {0: 1})
STRANGE = (*NUMBERS, *TEXTS, *OTHERS, msgpack.Timestamp(0), msgpack.ExtType(5, b"x"))
BROKEN = (b"\xc6\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff\xa1", b"\x81\xa2op\xa1\xff")
WORDS = ("op", "node", "id", "topic", "first", "window", "request", "message", "more")
IDS: Sequence[Any] = ("a", "b", [], {}, None, 0, "x" * 128, "x" * 129, b"a", float("nan"))


class Stranger:
    """Makes requests up.

    Args:
        operations: Fields of each operation, with values that are right.
        seed: Of what it makes up.
    """

    def __init__(self, operations: Mapping[str, Mapping[str, Any]], seed: int = 1) -> None:
        self._operations = {name: dict(fields) for name, fields in operations.items()}
        self._rng = random.Random(seed)

    def bursts(self, count: int) -> Iterator[list[bytes]]:
        """Yield so many requests, a few at a time; some are sent again in the same burst."""
        while count > 0:
            burst = [self._one() for _ in range(min(self._rng.randint(1, 4), count))]
            if self._rng.random() < 0.3:
                burst.append(self._rng.choice(burst))
            yield burst[:count]
            count -= len(burst)

    def _one(self) -> bytes:
        shape = self._rng.random()
        if shape < 0.1:
            return self._rng.randbytes(self._rng.randint(0, 60))
        if shape < 0.15:
            return b"\x91" * self._rng.randint(1, 3000) + b"\xc0"
        if shape < 0.2:
            return self._rng.choice(BROKEN)
        if shape < 0.3:
            return self._packed({self._word(): self._value() for _ in range(self._rng.randint(0, 5))})
        whole = self._packed(self._almost_right())
        if shape < 0.4:
            return whole[: self._rng.randint(0, len(whole))] + self._rng.randbytes(self._rng.randint(0, 4))
        if shape < 0.5:
            place = self._rng.randrange(len(whole))
            return whole[:place] + self._rng.randbytes(1) + whole[place + 1 :]
        return whole

    def _almost_right(self) -> dict[Any, Any]:
        op = self._rng.choice(list(self._operations))
        request: dict[Any, Any] = {"op": op, **self._operations[op]}
        if self._rng.random() < 0.7:
            request["id"] = self._rng.choice(IDS)
        for _ in range(self._rng.randint(0, 2)):
            request[self._rng.choice([*request, self._word()])] = self._value()
        if self._rng.random() < 0.1:
            del request[self._rng.choice(list(request))]
        return request

    def _word(self) -> str:
        return self._rng.choice(WORDS)

    def _value(self) -> Any:
        deep: Any = self._rng.choice(STRANGE)
        for _ in range(self._rng.choice((0, 0, 0, 1, 2, 400))):
            deep = [deep] if self._rng.random() < 0.5 else {"a": deep}
        return deep

    def _packed(self, request: dict[Any, Any]) -> bytes:
        return bytes(msgpack.packb(request))
