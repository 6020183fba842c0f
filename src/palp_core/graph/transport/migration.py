"""Follow a publisher that goes on at another place: two endpoints for a while, one order all the time."""

import itertools
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Generic, Protocol, TypeVar

import msgspec

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import Frame, Kind
from palp_core.graph.messages.message import decode_any

PATIENCE_NS = 5_000_000_000
"""How long what comes from a new place waits for the rest of the old one (assumed: no host is busier)."""

GIVE_UP_NS = 90_000_000_000
"""Longer than an old place stays for a slow reader."""

LOOK_NS = 500_000_000
"""How often to look whether a place that was followed to is there still."""

PLACES_REMEMBERED = 16
"""Places that were left and may still be announced, by what has arrived from them and was not read."""

Item = TypeVar("Item")


class Move(msgspec.Struct, frozen=True):
    """Payload of a frame of kind MOVED."""

    # ``prepare``: listen there too; ``here``: this is that place, and it publishes from now on; ``gone``:
    # from here comes nothing more; ``stay``: forget that place
    phase: str
    publish: str
    serve: str


def read_move(payload: bytes | memoryview) -> Move:
    move = decode_any(Move, payload)
    if not (move.publish.startswith("ipc://") and move.serve.startswith("ipc://")):
        raise SchemaMismatch(f"a publisher cannot move to {move.publish}")
    return move


class Connector(Protocol):
    def connect(self, endpoint: str) -> None: ...

    def disconnect(self, endpoint: str) -> None: ...


class Reorderer(Protocol):
    """What puts one topic's messages in order."""

    def begin_move(self) -> None:
        """Hold back what comes out of order."""

    def end_move(self, now_ns: int, last: int = 0) -> None:
        """Deliver what is held: nothing more comes from the old place."""


class MoveReorderer(Generic[Item]):
    """Puts one topic's frames in order while its publisher moves, for a reader that keeps no other order."""

    def __init__(self, deliver: Callable[[Item], None]) -> None:
        self._deliver = deliver
        self._moving = False
        self._since_ns = 0
        self._last = (-1, 0)
        self._held: dict[tuple[int, int], Item] = {}

    def arrive(self, frame: Frame, item: Item, now_ns: int) -> None:
        """Take a frame, and what is to be handed on for it."""
        if self._moving and now_ns - self._since_ns > PATIENCE_NS:
            self.end_move(now_ns)  # the old place has died before it could announce its end
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
        self._deliver(item)

    def begin_move(self) -> None:
        self._moving, self._since_ns = True, monotonic_ns()

    def end_move(self, now_ns: int, last: int = 0) -> None:
        self._moving = False
        for point in sorted(self._held):
            self._pass(True, point, self._held.pop(point))


@dataclass
class _Place:
    """One endpoint of a topic's publisher."""

    publish: str
    serve: str | None = None  # where the publisher answers; None: it has not announced that
    begun_ns: int | None = None  # when it announced that it publishes from now on; None: it has not
    finished: bool = False  # nothing more comes from here


class PublisherEndpoints:
    """Where one topic is published now, and where it goes on, in order.

    A slow reader may receive the next change of hands before it has had all of the last: then there are
    three places.
    """

    def __init__(self, publish: str, serve: str) -> None:
        self.home, self._home_serve = publish, serve
        self._places = [_Place(publish, serve)]
        self._left: deque[str] = deque(maxlen=PLACES_REMEMBERED)

    @property
    def places(self) -> list[str]:
        return [place.publish for place in self._places]

    @property
    def serve(self) -> str:
        return next(place.serve for place in reversed(self._places) if place.serve is not None)

    def add(self, publish: str) -> bool:
        """Take note of a place where it is to go on; return whether that is news."""
        if publish in self.places or publish in self._left:
            return False
        self._places.append(_Place(publish))
        return True

    def replace(self, publish: str) -> None:
        self._places[0] = _Place(publish, self._places[0].serve)

    def begin(self, publish: str, serve: str, now_ns: int) -> None:
        for place in self._places:
            if place.publish == publish:
                place.serve, place.begun_ns = serve, now_ns

    def finish_before(self, publish: str, serve: str) -> list[str]:
        """Note that everything goes on there; return the places that are to be left.

        This is sent by the place before, or by one before that: what never published was given up.
        """
        if publish not in self.places[1:]:
            return []
        index = self.places.index(publish)
        self._places[index].serve = serve
        for place in reversed(self._places[:index]):
            place.finished = True
            if place.begun_ns is not None:
                break
        return self._part()

    def _part(self) -> list[str]:
        """Leave places that have published their last, if none before them is to publish anything yet."""
        finished = list(itertools.takewhile(lambda place: place.finished, self._places))
        for place in finished:
            self.forget(place.publish)
        return [place.publish for place in finished]

    def forget(self, publish: str) -> None:
        self._places = [place for place in self._places if place.publish != publish]
        self._left.append(publish)

    def is_lost(self) -> bool:
        """Return whether the only place is gone: its publisher moved on before this reader listened there."""
        (*others, place) = self.places
        return not others and place != self.home and not Path(place.removeprefix("ipc://")).exists()

    def go_home(self) -> list[str]:
        """Begin again where its name leads; return the places that are to be left."""
        lost, self._places = self.places, [_Place(self.home, self._home_serve)]
        return lost

    def overdue(self, now_ns: int) -> list[str]:
        """Return the places before one that began to publish longer ago than an old one stays; leave them."""
        begun_ns = [now_ns if place.begun_ns is None else place.begun_ns for place in self._places]
        last = max((i for i, begun in enumerate(begun_ns) if now_ns - begun > GIVE_UP_NS), default=0)
        for place in self._places[:last]:
            place.finished = True
        return self._part()


class Migration:
    """Where the publishers of some topics are."""

    def __init__(
        self,
        socket: Connector,
        publishers: Mapping[str, tuple[str, str]],
        reorderers: Mapping[str, Reorderer] = MappingProxyType({}),
    ) -> None:
        self._socket, self._reorderers = socket, reorderers
        self._routes = {name: PublisherEndpoints(*ends) for name, ends in publishers.items()}
        self._next_look_ns = 0

    @property
    def servers(self) -> dict[str, str]:
        return {name: route.serve for name, route in self._routes.items()}

    def add(self, name: str, publish: str, serve: str) -> None:
        self._routes[name] = PublisherEndpoints(publish, serve)

    def remove(self, name: str) -> None:
        self._routes.pop(name, None)

    def relocate(self, name: str, publish: str) -> None:
        """Follow a topic to where the run directory has it now, if no frame has announced that."""
        if publish not in self._routes[name].places:
            self._socket.connect(publish)
            self._routes[name].replace(publish)  # the place before may publish more: it is not left

    def follow(self, frame: Frame, now_ns: int) -> None:
        move, name = read_move(frame.payload), frame.topic
        route = self._routes[name]
        if move.phase == "here":
            route.begin(move.publish, move.serve, now_ns)
        elif move.phase == "prepare":
            self._listen_at(name, move.publish)
        elif move.phase == "stay":
            if move.publish in route.places[1:]:
                route.forget(move.publish)
                self._leave([move.publish])
            if len(route.places) == 1:
                self._end_move(name, now_ns)
        elif move.phase == "gone":
            self._listen_at(name, move.publish)
            self._settle(name, route.finish_before(move.publish, move.serve), now_ns, frame.sequence)

    def tick(self, now_ns: int) -> None:
        """Give up places that have died before they could announce what follows."""
        for name, route in self._routes.items():
            if len(route.places) > 1:
                self._settle(name, route.overdue(now_ns), now_ns, 0)
        if now_ns >= self._next_look_ns:
            self._next_look_ns = now_ns + LOOK_NS
            for route in self._routes.values():
                if route.is_lost():
                    if route.home not in self._all_places():
                        self._socket.connect(route.home)
                    self._leave(route.go_home())

    def _listen_at(self, name: str, publish: str) -> None:
        known = self._all_places()
        if self._routes[name].add(publish):
            if publish not in known:
                self._socket.connect(publish)
            if name in self._reorderers:
                self._reorderers[name].begin_move()

    def _settle(self, name: str, parted: list[str], now_ns: int, last: int) -> None:
        self._leave(parted)
        if parted and len(self._routes[name].places) == 1:
            self._end_move(name, now_ns, last)

    def _end_move(self, name: str, now_ns: int, last: int = 0) -> None:
        if name in self._reorderers:
            self._reorderers[name].end_move(now_ns, last)

    def _leave(self, places: list[str]) -> None:
        for place in set(places) - self._all_places():
            self._socket.disconnect(place)

    def _all_places(self) -> set[str]:
        return {place for route in self._routes.values() for place in route.places}
