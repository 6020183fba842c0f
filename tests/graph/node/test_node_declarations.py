"""What a node's class declares is checked where it is defined: ports, handlers, rates, parameters, state."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from palp_core import (
    Act,
    ActionClient,
    Message,
    Node,
    Params,
    State,
    Sub,
    accept,
    every,
    execute,
    on,
    on_event,
)
from palp_core.errors import GraphError


class Word(Message):
    n: int


class Hearing(Node):
    word = Sub(Word)
    lift = ActionClient(Word, Word, Word)
    serve = Act(Word, Word, Word)

    @on(word)
    def take(self, word: Word) -> None: ...

    @on(lift)
    def arrive(self, ended: Any) -> None: ...

    @execute(serve)
    def work(self, goal: Any) -> None: ...


class Needy(State):
    value: int


async def later(self: Any, word: Word) -> None: ...


def lazily(self: Any, word: Word) -> Iterator[int]:
    yield word.n


def handled(handler: Callable[..., Any], name: str = "word") -> dict[str, Any]:
    """A port and its handler."""
    port = Sub(Word)
    return {name: port, "take": on(port)(handler)}


def twice() -> dict[str, Any]:
    port = Sub(Word)
    return {"word": port, "one": on(port)(lambda _, __: None), "two": on(port)(lambda _, __: None)}


def paced() -> dict[str, Any]:
    port = Act(Word, Word, Word)
    return {"lift": port, "rise": execute(port, "step_hs")(lambda _, __: None)}


MINE = ("name", "state", "params", "rng", "finish", "on_activate", "_order")


@pytest.mark.parametrize(
    ("body", "mistake"),
    [
        ({"word": Sub(Word)}, "port 'word' has no handler; mark a method with @on or @serve"),
        ({"lift": Act(Word, Word, Word)}, "port 'lift' has no handler; mark a method with @execute"),
        ({"take": on(Hearing.word)(lambda _, __: None)}, "not declared on this class"),
        ({"mind": on_event(Hearing.word)(lambda _, __: None)}, "not declared here"),
        (
            {"look": accept(Hearing.serve)(lambda _, __: None)},
            "handlers name an action 'serve' that this class does not declare",
        ),
        (twice(), "two handlers"),
        ({"tick": every("speed_hz")(lambda _: None)}, "no parameter 'speed_hz' for its rate; declared: none"),
        ({"tick": every(20.0)(lambda _: None)}, r"no parameter '20\.0' for its rate"),  # type: ignore[arg-type]
        (paced(), "no parameter 'step_hs' for its rate"),
        ({"__annotations__": {"params": int}}, "'params' must be annotated"),
        ({"__annotations__": {"state": Params}}, "'state' must be annotated"),
        ({"__annotations__": {"state": Needy}}, "needs a default"),
        (handled(later), "plain function"),
        (handled(lazily), "plain function"),
        *((handled(lambda _, __: None, name), f"a port cannot be called '{name}'") for name in MINE),
    ],
)
def test_what_a_class_must_not_declare_is_refused_by_name(body: dict[str, Any], mistake: str) -> None:
    with pytest.raises(GraphError, match=mistake):
        type("Wrong", (Node,), body)
