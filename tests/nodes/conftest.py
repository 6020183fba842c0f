"""A successor to a node under test, and the bytes that a node has sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from palp_core import Bench, Node
from palp_core.graph.messages.frame import parse
from palp_core.graph.node.lifecycle import Transition

Successor = Callable[..., Bench[Any]]


def replace(old: Bench[Any], node_class: type[Node] | None = None, **params: Any) -> Bench[Any]:
    """Return a bench on which another node continues where this one stands."""
    kept = old.executor.spec.params if node_class is None else {}
    new: Bench[Any] = Bench(node_class or type(old.node), {**kept, **params}, active=False)
    new.clock.set(old.clock.now_ns())
    new._sequence.update(old._sequence)
    new.executor.transition(Transition.CONFIGURE)
    new.executor.take_over(old.hand_over())
    return new


def sent_bytes(bench: Bench[Any]) -> list[bytes]:
    """Return every frame of the node's own outputs."""
    return [bytes(frame) for frame in bench.frames if not parse(frame).topic.endswith("/_order")]


@pytest.fixture
def successor() -> Successor:
    return replace


@pytest.fixture
def frames_of() -> Callable[[Bench[Any]], list[bytes]]:
    return sent_bytes
