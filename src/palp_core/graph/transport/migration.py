"""Follow a publisher that goes on at another place: two endpoints for a while, one order all the time."""

from collections.abc import Callable, Mapping
from typing import Generic, Protocol, TypeVar

import msgspec

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import Frame, Kind
from palp_core.graph.messages.message import decode_any

PATIENCE_NS = 5_000_000_000
"""How long what comes from a new place waits for the old one's word (assumed: no host is busier)."""

GIVE_UP_NS = 90_000_000_000
"""Longer than an old place stays for a slow reader."""

Item = TypeVar("Item")


class Move(msgspec.Struct, frozen=True):
    """Payload of a frame of kind MOVED.

    Attributes:
        phase: ``prepare``: listen there too; ``here``: this is that place, and it speaks from now on;
            ``gone``: from here comes nothing more; ``stay``: forget that place.
        publish: That place's endpoint.
        serve: Where it answers.
    """

    phase: str
    publish: str
    serve: str


def read_move(payload: memoryview) -> Move:
    """Decode a MOVED frame's payload.

    Raises:
        SchemaMismatch: It is none, or sends readers to another host.
    """
    move = decode_any(Move, payload)
    if not (move.publish.startswith("ipc://") and move.serve.startswith("ipc://")):
        raise SchemaMismatch(f"a publisher cannot move to {move.publish}")
    return move


class _Ear(Protocol):
    def connect(self, endpoint: str) -> None: ...

    def disconnect(self, endpoint: str) -> None: ...


class Ordered(Protocol):
    """What puts one topic's messages in order."""

    def begin_move(self) -> None:
        """Hold back what comes out of order."""

    def end_move(self, now_ns: int, last: int = 0) -> None:
        """Hand on what is held: nothing is to come from the old place."""


class Unordered:
    """For a reader that puts everything in order later: nothing is held back."""

    def begin_move(self) -> None:
        """Go on as before."""

    def end_move(self, now_ns: int, last: int = 0) -> None:
        """Go on as before."""


class Turns(Generic[Item]):
    """Puts one topic's frames in order while its publisher moves, for a reader that keeps no other order.

    Args:
        hand_on: Takes what came with each frame, in order.
    """

    def __init__(self, hand_on: Callable[[Item], None]) -> None:
        self._hand_on = hand_on
        self._moving = False
        self._since_ns = 0
        self._last = (-1, 0)
        self._held: dict[tuple[int, int], Item] = {}

    def arrive(self, frame: Frame, item: Item, now_ns: int) -> None:
        """Take a frame, and what is to be handed on for it."""
        if self._moving and now_ns - self._since_ns > PATIENCE_NS:
            self.end_move(now_ns)  # the old place has died before it could say that it was done
        point = (frame.epoch, frame.sequence)
        is_next = point <= (self._last[0], self._last[1] + 1)
        if not self._moving or is_next:
            self._pass(frame.kind == Kind.DATA, point, item)
        elif frame.kind == Kind.DATA:
            self._since_ns = now_ns if not self._held else self._since_ns
            self._held[point] = item
        while self._moving and (following := (self._last[0], self._last[1] + 1)) in self._held:
            self._pass(True, following, self._held.pop(following))

    def _pass(self, is_data: bool, point: tuple[int, int], item: Item) -> None:
        if is_data or self._last[0] < 0:
            self._last = max(self._last, point)
        self._hand_on(item)

    def begin_move(self) -> None:
        """Hold back what comes out of order."""
        self._moving, self._since_ns = True, monotonic_ns()

    def end_move(self, now_ns: int, last: int = 0) -> None:
        """Hand on what is held."""
        self._moving = False
        for point in sorted(self._held):
            self._pass(True, point, self._held.pop(point))


class Migration:
    """Where the publishers of some topics are.

    Args:
        ear: The subscription to all of them.
        publishers: Per topic, where it is published and where its publisher answers.
        orders: Puts each topic in order.
        listening: Is told a topic and the second place where it is listened to.
    """

    def __init__(
        self,
        ear: _Ear,
        publishers: Mapping[str, tuple[str, str]],
        orders: Mapping[str, Ordered],
        listening: Callable[[str, str], None] = lambda *_: None,
    ) -> None:
        self._listening = listening
        self._ear, self._orders = ear, orders
        self._at = {name: publish for name, (publish, _) in publishers.items()}
        self._next: dict[str, str] = {}
        self._spoke: dict[str, int] = {}
        self.servers = {name: serve for name, (_, serve) in publishers.items()}

    def add(self, name: str, publish: str, serve: str) -> None:
        """Follow one more topic."""
        self._at[name], self.servers[name] = publish, serve

    def relocate(self, name: str, publish: str) -> None:
        """Take the run directory's word for where a topic is published now, if no frame has told of it."""
        if publish not in (self._at[name], self._next.get(name)):
            self._ear.connect(publish)
            self._at[name] = publish  # the place before may have more to say: it is not left

    def follow(self, frame: Frame, now_ns: int) -> None:
        """Take a frame of kind MOVED.

        Raises:
            SchemaMismatch: It says nothing that can be followed.
        """
        move, name = read_move(frame.payload), frame.topic
        if move.phase == "here":
            self.servers[name] = move.serve
            self._spoke[name] = now_ns
        elif self._at[name] == move.publish:
            return  # it is known there already
        elif move.phase == "prepare":
            self._listen_at(name, move.publish)
        elif move.phase == "stay":
            self._forget(name)
            self._orders[name].end_move(now_ns)
        elif move.phase == "gone":
            self._listen_at(name, move.publish)
            self.servers[name] = move.serve
            self._part(name, now_ns, frame.sequence)

    def tick(self, now_ns: int) -> None:
        """Give up old places that have died before they could say that they were done."""
        for name in [name for name, since_ns in self._spoke.items() if now_ns - since_ns > GIVE_UP_NS]:
            if name in self._next:
                self._part(name, now_ns, 0)
            self._spoke.pop(name, None)

    def _part(self, name: str, now_ns: int, last: int) -> None:
        """Listen at the old place no longer."""
        old, self._at[name] = self._at[name], self._next.pop(name)
        self._spoke.pop(name, None)
        if old not in self._at.values():
            self._ear.disconnect(old)
        self._orders[name].end_move(now_ns, last)

    def _listen_at(self, name: str, publish: str) -> None:
        if self._next.get(name) == publish:
            return
        self._forget(name)
        if publish not in {*self._next.values(), *self._at.values()}:
            self._ear.connect(publish)
        self._next[name] = publish
        self._orders[name].begin_move()
        self._listening(name, publish)

    def _forget(self, name: str) -> None:
        publish = self._next.pop(name, None)
        if publish is not None and publish not in {*self._next.values(), *self._at.values()}:
            self._ear.disconnect(publish)
