"""What a node class declares is checked where it is defined."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from palp_core.errors import GraphError
from palp_core.graph.messages.message import Message
from palp_core.graph.node.node import Node, State
from palp_core.graph.node.ports import Sub, every, on


class Word(Message):
    n: int


class Other(Message):
    n: int


class Speaker(Node):
    word = Sub(Word)

    @on(word)
    def take(self, word: Word) -> None: ...


def test_a_handler_for_a_port_of_another_class_is_refused() -> None:
    with pytest.raises(GraphError, match="not declared on this class"):

        class Confused(Node):
            word = Sub(Other)

            @on(Speaker.word)
            def take(self, word: Word) -> None: ...


def test_what_a_node_class_forgets_is_said_at_its_definition() -> None:
    with pytest.raises(GraphError, match="port 'word' has no handler"):
        type("Deaf", (Node,), {"word": Sub(Word)})
    with pytest.raises(GraphError, match="no parameter 'speed_hz' for its rate; declared: none"):
        type("Typo", (Node,), {"tick": every("speed_hz")(lambda self: None)})
    with pytest.raises(GraphError, match=r"no parameter '20\.0' for its rate"):
        type("Rate", (Node,), {"tick": every(20.0)(lambda self: None)})  # type: ignore[arg-type]
    with pytest.raises(GraphError, match="'params' must be annotated"):
        type("Odd", (Node,), {"__annotations__": {"params": int}})
    port = Sub(Word)
    with pytest.raises(GraphError, match="two handlers"):
        type(
            "Double", (Node,), {"w": port, "a": on(port)(lambda s, w: None), "b": on(port)(lambda s, w: None)}
        )

    class Needy(State):
        value: int

    with pytest.raises(GraphError, match="needs a default"):
        type("Needs", (Node,), {"__annotations__": {"state": Needy}})


@pytest.mark.parametrize("name", ["name", "state", "params", "rng", "finish", "on_activate", "_order"])
def test_a_port_that_would_hide_a_part_of_every_node_is_refused(name: str) -> None:
    port = Sub(Word)
    with pytest.raises(GraphError, match=f"a port cannot be called '{name}'"):
        type("Hiding", (Node,), {name: port, "take": on(port)(lambda self, word: None)})


def test_a_handler_that_would_never_run_is_refused() -> None:
    with pytest.raises(GraphError, match="plain function"):

        class Later(Node):
            word = Sub(Word)

            @on(word)  # type: ignore[arg-type]
            async def take(self, word: Word) -> None: ...

    with pytest.raises(GraphError, match="plain function"):

        class Lazy(Node):
            word = Sub(Word)

            @on(word)  # type: ignore[arg-type]
            def take(self, word: Word) -> Iterator[int]:
                yield word.n
