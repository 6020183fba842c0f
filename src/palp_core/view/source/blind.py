"""A source of a blinded session: it passes on what is named as harmless, and nothing else.

Whatever a page does, what is not named never reaches it, in messages or in what nodes say of themselves.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.discovery.troubles import Trouble
from palp_core.graph.messages.topic import Topic
from palp_core.view.source.live import HAS_ENDED
from palp_core.view.source.overview import NodeState, Overview
from palp_core.view.source.protocol import Heard, ViewSource, Watch

WHOLE = "*"
"""In place of a message's fields: all of them."""
HIDDEN = "a blinded session does not show it"


class Harmless(msgspec.Struct, frozen=True, kw_only=True):
    """What may be seen of a blinded session.

    Attributes:
        fields: Of each type of message that may be seen the fields that may be, or :data:`WHOLE`.
        speakers: Types of messages whose publishers' own words may be read: what is wrong with them.
        calls: Services that may be called; nothing else may be pressed.
    """

    fields: Mapping[str, Collection[str]] = {}
    speakers: Collection[str] = ()
    calls: Collection[str] = ()


class BlindSource:
    """What may be seen of a source.

    Args:
        source: All of it.
        harmless: What may be seen.
    """

    def __init__(self, source: ViewSource, harmless: Harmless) -> None:
        self._source, self._harmless = source, harmless

    def overview(self) -> Overview:
        """Return nodes, wires and their figures; words only of those who may be heard."""
        found = self._source.overview()
        heard = {topic.node for topic in self._source.topics() if topic.type in self._harmless.speakers}
        return msgspec.structs.replace(
            found,
            nodes=[node if node.name in heard else _mute(node) for node in found.nodes],
            troubles=[one if one.where.removeprefix("/") in heard else _muted(one) for one in found.troubles],
        )

    def topics(self) -> list[Topic]:
        """Return those of which something may be seen, as far as it may."""
        return [_cut(topic, fields) for topic in self._source.topics() if (fields := self._fields(topic))]

    def watch(self, topic: str) -> Watch:
        """Look at what may be seen of a topic.

        Raises:
            GraphError: There is none of that name, or nothing of it may be seen.
        """
        known = next((one for one in self._source.topics() if one.name == topic), None)
        if known is None or not (fields := self._fields(known)):
            raise GraphError(f"{topic}: {HIDDEN}")
        return BlindWatch(self._source.watch(topic), fields)

    def remembered(self, topics: Sequence[str]) -> Iterator[tuple[str, Heard]]:
        """Yield what may be seen of what is remembered."""
        known = {one.name: fields for one in self._source.topics() if (fields := self._fields(one))}
        for name, heard in self._source.remembered([topic for topic in topics if topic in known]):
            yield name, _seen(heard, known[name])

    def launch(self) -> dict[str, Any]:
        """Return nothing: parameters tell what was drawn."""
        return {}

    def close(self) -> None:
        self._source.close()

    def _fields(self, topic: Topic) -> Collection[str]:
        return self._harmless.fields.get(topic.type, ())


class BlindWatch:
    """What may be seen of a topic.

    Args:
        watch: All of it.
        fields: That may be seen.
    """

    def __init__(self, watch: Watch, fields: Collection[str]) -> None:
        self._watch, self._fields = watch, fields
        self.topic = _cut(watch.topic, fields)

    def latest(self) -> Heard | None:
        """Return what may be seen of the last message; None before the first."""
        heard = self._watch.latest()
        return None if heard is None else self._seen(heard)

    def drain(self) -> list[Heard]:
        """Return what may be seen of what has come since the last call."""
        return [self._seen(heard) for heard in self._watch.drain()]

    @property
    def rate_hz(self) -> float | None:
        return self._watch.rate_hz

    def close(self) -> None:
        self._watch.close()

    def _seen(self, heard: Heard) -> Heard:
        return _seen(heard, self._fields)


def _seen(heard: Heard, fields: Collection[str]) -> Heard:
    return Heard(heard.stamp_ns, heard.sequence, _kept(heard.message, fields))


def _kept(values: Mapping[str, Any], fields: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if WHOLE in fields or name in fields}


def _cut(topic: Topic, fields: Collection[str]) -> Topic:
    """Return a topic whose schema, default values among it, has nothing but these fields."""
    if WHOLE in fields:
        return topic
    schema = {
        "type": "object",
        "properties": _kept(topic.json_schema.get("properties", {}), fields),
    }
    return msgspec.structs.replace(topic, json_schema=schema)


def _mute(node: NodeState) -> NodeState:
    return msgspec.structs.replace(node, why=HIDDEN) if node.why else node


def _muted(trouble: Trouble) -> Trouble:
    """Return a trouble in words that are our own: of a reader's losses, of an end, or that there is one."""
    if " -> " in trouble.where or trouble.text == HAS_ENDED:
        return trouble
    return msgspec.structs.replace(trouble, text=f"something is wrong; {HIDDEN}", advice="")
