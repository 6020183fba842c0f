"""The node base class: typed ports, frozen parameters, a state that survives, short handlers.

A node owns no socket, thread, clock, random generator or global. An executor hands it time, randomness and
messages; so the same class runs in its own process, among others in one process, and on a test bench.
"""

from __future__ import annotations

import inspect
import logging
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, dataclass_transform

import msgspec

from palp_core.errors import GraphError, PalpError
from palp_core.graph.node.context import NodeContext
from palp_core.graph.node.lifecycle import LifecycleHooks
from palp_core.graph.node.ports import (
    MARKS,
    Act,
    ActionClient,
    Client,
    Mark,
    Port,
    Pub,
    Srv,
    Sub,
    Timer,
    action_parts,
)

if TYPE_CHECKING:
    import numpy as np


class _ParamsMeta(msgspec.StructMeta):
    def __new__(mcls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> _ParamsMeta:
        return super().__new__(
            mcls, name, bases, namespace, frozen=True, kw_only=True, forbid_unknown_fields=True
        )


@dataclass_transform(kw_only_default=True, field_specifiers=(msgspec.field,))
class Params(msgspec.Struct, metaclass=_ParamsMeta):
    """Base class of a node's parameters: frozen and checked; a change replaces the whole object.

    A parameter that is only looked at when the node is configured is marked: ``device: ReadOnly[str] =
    "sim"``.
    """


T = TypeVar("T")
P = TypeVar("P", bound=Port)
ReadOnly = Annotated[T, msgspec.Meta(extra={"read_only": True})]
"""Mark a parameter that no one can change while the node runs."""


class _StateMeta(msgspec.StructMeta):
    def __new__(mcls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> _StateMeta:
        return super().__new__(mcls, name, bases, namespace, kw_only=True, forbid_unknown_fields=True)


@dataclass_transform(kw_only_default=True, field_specifiers=(msgspec.field,))
class State(msgspec.Struct, metaclass=_StateMeta):
    """Base class of what a node remembers: plain data with defaults, which a swap can hand over.

    ``version`` grows when the meaning of a field changes. A class that can read an older version defines
    ``migrate(cls, old)``; one that can follow another node class defines ``adopt(cls, old)``. Both are class
    methods, get a :class:`~palp_core.graph.node.handover.Predecessor`, and return a state or raise to refuse.
    """

    version: ClassVar[int] = 1


class Mistakes(dict[str, str]):
    """What is wrong with parameters, by parameter; under "" what concerns several."""

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Add why what is tried in here fails; an error that another parameter has already is left out."""
        try:
            yield
        except (PalpError, ValueError) as error:
            if str(error) not in self.values():
                self[name] = str(error)


class Node(LifecycleHooks):
    """Base class of all nodes. A subclass declares ports, parameters, state and handlers.

    Attributes:
        moves: The node commands motion: it is brought to a safe state first when a graph ends.
        simulates: The node stands for the physical world and may read ports named ``truth``.
        records: The node is the experiment's record and may read ports named ``truth``.
        on_probation: At a swap the handlers are tried on the last messages first, which the predecessor has
            had already; and the old node stands by until the first of them have run well.
        same_params: By input, the parameters that must be as in the node that is wired to it, if it has them.
        proven_by: What proves the node then, if not every handler does: the name of an attribute that counts
            it from the moment at which the node takes over, as in ``choice_count``.
    """

    moves: ClassVar[bool] = False
    simulates: ClassVar[bool] = False
    records: ClassVar[bool] = False
    on_probation: ClassVar[bool] = False
    same_params: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    proven_by: ClassVar[str] = ""
    params: Params
    state: State

    def __init__(self, context: NodeContext) -> None:
        self._context = context

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        declaration_of(cls)

    @classmethod
    def shaped(cls, name: str, params: Mapping[str, Any]) -> type[Node]:  # noqa: ARG003 - for subclasses
        """Return the class to run under a name with parameters: another one where these decide its ports."""
        return cls

    @classmethod
    def examine(cls, params: Any) -> dict[str, str]:
        """Return what is wrong with parameters though each is within its bounds, by parameter."""
        found = Mistakes()
        cls.find_mistakes(params, found)
        return found

    @classmethod
    def find_mistakes(cls, params: Any, mistakes: Mistakes) -> None:
        """Add what is wrong with parameters though each is within its bounds.

        A file that one names, a device that cannot be so, values that contradict each other. It is called
        before any start, and opens no device.
        """

    @property
    def name(self) -> str:
        """Running name of the node in its graph."""
        return self._context.name

    @property
    def rng(self) -> np.random.Generator:
        """The node's random generator: a function of the graph's seed and the node's name."""
        return self._context.rng

    @property
    def log(self) -> logging.Logger:
        """The node's logger."""
        return self._context.log

    def now_ns(self) -> int:
        """Return the time on the graph's clock, in ns; constant within a handler."""
        return self._context.now_ns()

    def finish(self, exit_code: int = 0) -> None:
        """End this node's work; with ``on_exit: shutdown`` in the launch file this ends the run."""
        self._context.finish(exit_code)

    def on_parameters(self, params: Params) -> None:
        """Look at changed parameters before they take effect; raise ValueError to refuse them all."""

    def on_error(self, error: Exception) -> None:
        """Run after a handler raised, before the node is shut down."""


def class_name(node_class: type[Node]) -> str:
    """Return ``module:Class``, by which a hand-over names who had the state."""
    return f"{node_class.__module__}:{node_class.__qualname__}"


class Declaration(msgspec.Struct, frozen=True, kw_only=True):
    """What a node class declares, in declaration order; the parts of an action after all that is its own.

    ``roles`` are the further handlers of each action: ``accept``, ``cancel`` and ``feedback``.
    """

    ports: dict[str, Port]
    roles: dict[str, dict[str, Callable[..., Any]]]
    handlers: dict[str, Callable[..., Any]]
    event_handlers: dict[str, Callable[..., Any]]
    params: type[Params]
    state: type[State]

    def of(self, kind: type[P]) -> dict[str, P]:
        """Return the ports of a kind, by name."""
        return {name: port for name, port in self.ports.items() if isinstance(port, kind)}

    @property
    def wired(self) -> list[Port]:
        """Every port that others can be wired to, or see."""
        kinds = (Sub, Pub, Srv, Client, Act, ActionClient)
        return [port for kind in kinds for port in self.of(kind).values()]


_DECLARATIONS: dict[Any, Declaration] = {}


def declaration_of(cls: type[Node]) -> Declaration:
    """Collect and check what a node class declares."""
    declaration = _DECLARATIONS.get(cls)
    if declaration is None:
        declaration = _DECLARATIONS[cls] = _declare(cls)
    return declaration


def _declare(cls: type[Node]) -> Declaration:
    where = class_name(cls)
    hints = typing.get_type_hints(cls)
    params, state = hints.get("params", Params), hints.get("state", State)
    for kind, base, label in ((params, Params, "params"), (state, State, "state")):
        if not (isinstance(kind, type) and issubclass(kind, base)):
            raise GraphError(f"{where}: '{label}' must be annotated with a subclass of {base.__name__}")
    members: dict[str, Any] = {}
    for ancestor in reversed(cls.__mro__):
        members.update(vars(ancestor))
    ports = {name: value for name, value in members.items() if isinstance(value, Port)}
    handlers: dict[str, Callable[..., Any]] = {}
    event_handlers: dict[str, Callable[..., Any]] = {}
    roles: dict[str, dict[str, Callable[..., Any]]] = {}
    rates: dict[str, str] = {}
    marked: list[tuple[str, Any, Mark]] = [
        (name, value, mark) for name, value in members.items() for mark in getattr(value, MARKS, ())
    ]
    for name, value, mark in marked:
        marked_port: Port = mark.port
        if mark.role == "event":
            if ports.get(marked_port.name) is not marked_port or marked_port.name in event_handlers:
                raise GraphError(
                    f"{where}.{name} handles events of a port that is not declared here, or twice"
                )
            event_handlers[marked_port.name] = value
        elif mark.role != "handle":
            roles.setdefault(marked_port.name, {})[mark.role] = value
        else:
            _check_handler(f"{where}.{name}", value)
            if isinstance(marked_port, Timer) and marked_port.name not in ports:
                ports[marked_port.name] = marked_port
            if ports.get(marked_port.name) is not marked_port:
                raise GraphError(f"{where}.{name} handles a port that is not declared on this class")
            if marked_port.name in handlers:
                raise GraphError(f"{where}: port '{marked_port.name}' has two handlers")
            handlers[marked_port.name], rates[marked_port.name] = value, mark.hz
    for name, port in ports.items():
        if name.startswith("_") or name in {*dir(Node), *Node.__annotations__}:
            raise GraphError(
                f"{where}: a port cannot be called '{name}': the name is the runtime's; choose another"
            )
        if isinstance(port, Timer) and not hasattr(params, str(port.hz)):
            known = ", ".join(params.__struct_fields__) or "none"
            raise GraphError(f"{where}.{name}: no parameter '{port.hz}' for its rate; declared: {known}")
        if not isinstance(port, Pub) and name not in handlers:
            marks = "@execute" if isinstance(port, Act) else "@on or @serve"
            raise GraphError(f"{where}: port '{name}' has no handler; mark a method with {marks}")
    for name in roles:
        if not isinstance(ports.get(name), Act | ActionClient):
            raise GraphError(
                f"{where}: handlers name an action '{name}' that this class does not declare; declare it"
            )
    for name, port in list(ports.items()):
        if isinstance(port, Act | ActionClient):
            rate = rates[name]
            if rate and not hasattr(params, rate):
                raise GraphError(f"{where}.{handlers[name].__name__}: no parameter '{rate}' for its rate")
            parts = action_parts(port, handlers[name], rate)
            ports |= parts.ports
            handlers |= parts.handlers
            event_handlers |= parts.event_handlers
    try:
        state()
    except TypeError as error:
        raise GraphError(f"{where}: every field of {state.__name__} needs a default: {error}") from error
    return Declaration(
        ports=ports,
        roles=roles,
        handlers=handlers,
        event_handlers=event_handlers,
        params=params,
        state=state,
    )


def _check_handler(where: str, handler: Callable[..., Any]) -> None:
    if inspect.iscoroutinefunction(handler) or inspect.isgeneratorfunction(handler):
        raise GraphError(f"{where}: a handler is a plain function: no async, no yield")
