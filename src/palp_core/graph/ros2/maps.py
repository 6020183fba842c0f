"""Maps between a graph and ROS 2: functions from a message of one to a message of the other.

A map is a Python module. Its decorated functions name both ends, and their annotations the graph's messages::

    WrenchStamped = message_type("geometry_msgs/msg/WrenchStamped")

    @to_ros2("/torque/block", "/torque", WrenchStamped)
    def wrench(block: TorqueBlock, times: Times) -> Any:
        message = WrenchStamped()
        message.header.stamp = times.to_ros2(block.stamp_ns)
        message.wrench.torque.x = block.torque_n_m[-1]
        return message
"""

from __future__ import annotations

import inspect
import re
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import msgspec

from palp_core.errors import GraphError, PalpError
from palp_core.foreign import describe_foreign
from palp_core.graph.description.launch_file import find_workspace
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.loading import load_module
from palp_core.graph.problems import Mark
from palp_core.graph.ros2.message_types import message_type
from palp_core.graph.workspaces.modules import module_file

_PALP_NAME = re.compile(r"/[A-Za-z]\w*/[A-Za-z]\w*")
_ROS_NAME = re.compile(r"(/[A-Za-z_]\w*)+")
_SERVICE_TYPE = re.compile(r"[a-z][a-z0-9_]*/srv/[A-Z][A-Za-z0-9]*")
_NS = 1_000_000_000

Kind = Literal["to_ros2", "from_ros2", "service", "call", "parameters"]
Decorator = Callable[[Callable[..., Any]], "Entry"]


class Times(NamedTuple):
    """Times of a message on the graph's clock and on ROS 2's.

    Attributes:
        stamp_ns: When it was published or, from ROS 2, arrived, on the graph's clock.
        offset_ns: What ROS 2's clock is ahead of the graph's: 0 in simulated time.
    """

    stamp_ns: int
    offset_ns: int = 0

    def to_ros2(self, ns: int) -> Any:
        """Return a time of the graph as ROS 2's ``Time``."""
        sec, nanosec = divmod(ns + self.offset_ns, _NS)
        return message_type("builtin_interfaces/msg/Time")(sec=sec, nanosec=nanosec)

    def to_palp(self, time: Any) -> int:
        """Return ROS 2's ``Time`` in ns on the graph's clock."""
        return int(time.sec * _NS + time.nanosec - self.offset_ns)


@dataclass(frozen=True, eq=False)
class Entry:
    kind: Kind
    mark: Mark
    palp: str  # topic, external port or service of the graph; of ``parameters`` a node, "" for all
    ros: str = ""
    ros_type: str = ""
    convert: Callable[..., Any] = lambda *_: None  # called with :class:`Times` last
    messages: tuple[type[Message], ...] = ()  # the graph's: one of a topic, request and reply of a service
    to: str = ""  # of a call, the external port that takes the reply
    qos: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Both ends, in the direction in which messages cross."""
        arrow = {"to_ros2": "->", "call": "calls"}.get(self.kind)
        if arrow is not None:
            return f"{self.palp} {arrow} {self.ros}"
        return f"{self.ros} {'calls' if self.kind == 'service' else '->'} {self.palp}"

    @property
    def nodes(self) -> list[str]:
        return [name.split("/")[1] for name in (self.palp, self.to) if name]

    def to_ros2(self, payload: bytes | memoryview, times: Times) -> Iterator[tuple[int, Any]]:
        """Yield the messages of ROS 2 that one of the graph becomes, each after its time."""
        made = self.convert(decode(self.messages[0], payload), times)
        found: Any = made if inspect.isgenerator(made) else [(times.stamp_ns, made)]
        yield from found

    @contextmanager
    def catch(self) -> Iterator[None]:
        """Turn what its function raises into a GraphError with its place."""
        try:
            yield
        except PalpError:
            raise
        except Exception as error:
            raise GraphError(f"{self.mark}: {describe_foreign(error)}") from error


def to_ros2(palp: str, ros: str, kind: Any, **qos: Any) -> Decorator:
    """Publish a topic of the graph in ROS 2.

    The function takes a message (and its :class:`Times`, if it has a second parameter) and returns ROS 2's
    message. A generator yields several, each after its time on the graph's clock: ``yield at_ns, message``.

    Args:
        palp: The topic, ``/node/port``.
        ros: The topic in ROS 2.
        kind: Its type, from :func:`~palp_core.graph.ros2.message_types.message_type`.
        qos: Policies by palp's names that differ from what the graph's publisher offers.
    """
    return _decorator("to_ros2", palp, ros, kind.__msgtype__, qos=qos)


def from_ros2(ros: str, palp: str, kind: Any, **qos: Any) -> Decorator:
    """Publish a topic of ROS 2 on an external port of the graph.

    The function takes ROS 2's message (and its :class:`Times`) and returns the port's message.

    Args:
        ros: The topic in ROS 2.
        palp: The port, ``/node/port``, which the launch file declares ``external: true``.
        kind: The topic's type, from :func:`~palp_core.graph.ros2.message_types.message_type`.
        qos: Policies by palp's names; without: reliable, depth 10.
    """
    return _decorator("from_ros2", palp, ros, kind.__msgtype__, qos=qos)


def serve_ros2(palp: str, ros: str, kind: str) -> Decorator:
    """Serve a service of the graph in ROS 2.

    The function takes ROS 2's request and response (and :class:`Times`). It yields the graph's request, is
    sent the graph's reply, and returns the response.

    Args:
        palp: The service, ``/node/port``.
        ros: The service in ROS 2.
        kind: Its type, ``std_srvs/srv/Trigger``.
    """
    return _decorator("service", palp, ros, kind)


def call_ros2(palp: str, ros: str, kind: str, to: str = "") -> Decorator:
    """Call a service of ROS 2 for each message of a topic.

    The function takes the message and ROS 2's request (and :class:`Times`). It yields the request, is sent
    ROS 2's response, and returns the message for the port ``to``.

    Args:
        palp: The topic, ``/node/port``.
        ros: The service in ROS 2.
        kind: Its type, ``std_srvs/srv/SetBool``.
        to: External port of the graph; "" for none.
    """
    return _decorator("call", palp, ros, kind, to)


def share_parameters(node: str = "") -> Entry:
    """Let ROS 2 get, set, list and describe the parameters of a node; "" for every node of the graph."""
    return Entry("parameters", _place(inspect.currentframe()), f"/{node.removeprefix('/')}" if node else "")


def read_map(name: str) -> list[Entry]:
    """Return what a map lets cross.

    Args:
        name: Its module (``nodes.ros2_map``) or its file (``map.py``).

    Raises:
        GraphError: It cannot be imported, or has mistakes.
    """
    is_file = name.endswith(".py")
    workspace = str(find_workspace(Path(name if is_file else "file")))
    file = Path(name).resolve() if is_file else module_file(name, workspace)
    try:
        module = load_module(str(file) if is_file else name, workspace)
    except (Exception, SystemExit) as error:
        frames = [one for one in traceback.extract_tb(error.__traceback__) if Path(one.filename) == file]
        place = f"{file}:{frames[-1].lineno}" if frames else name
        text = str(error) if isinstance(error, PalpError) else describe_foreign(error)
        raise GraphError(f"{place}: {text}") from error
    return _entries(vars(module).values())


def _entries(values: Iterable[Any]) -> list[Entry]:
    found = list(dict.fromkeys(value for value in values if isinstance(value, Entry)))
    if not found:
        raise GraphError("the map has no decorated function; add one with @to_ros2 or @from_ros2")
    sent = {entry.ros for entry in found if entry.kind == "to_ros2"}
    first: dict[tuple[str, ...], Entry] = {}
    for entry in found:
        if entry.kind == "from_ros2" and entry.ros in sent:
            raise GraphError(f"{entry.mark}: this map publishes {entry.ros}, too; rename one of both")
        key = (entry.kind, entry.ros, "" if entry.kind == "service" else entry.palp)
        if first.setdefault(key, entry) is not entry:
            raise GraphError(
                f"{entry.mark}: {entry.name} is at {first[key].mark} already; remove one of both"
            )
    return found


def as_plain(message: Message) -> Any:
    """Return a message as a map, as it travels."""
    return msgspec.msgpack.decode(encode(message))


def as_message(kind: type[Message], plain: Any) -> Message:
    """Return a message of a map, as it travels; a SchemaMismatch if it is none of that class."""
    return decode(kind, msgspec.msgpack.encode(plain))


def _decorator(
    kind: Kind, palp: str, ros: str, ros_type: str, to: str = "", qos: Mapping[str, Any] | None = None
) -> Decorator:
    service = kind in ("service", "call")

    def decorate(function: Callable[..., Any]) -> Entry:
        for name, form, example in (
            (palp, _PALP_NAME, "/node/port"),
            (to or "/node/port", _PALP_NAME, "/node/port"),
            (ros, _ROS_NAME, "a name from the root, as in /torque"),
            *([(ros_type, _SERVICE_TYPE, "PACKAGE/srv/NAME")] if service else ()),
        ):
            if form.fullmatch(name) is None:
                raise GraphError(f"{function.__name__}: '{name}' is not a name; write {example}")
        Qos(**(qos or {}))
        messages = _messages(kind, function, to)
        given = 2 if service else 1
        takes_times = len(inspect.signature(function).parameters) > given
        convert = function if takes_times else lambda *values: function(*values[:given])
        mark = Mark(function.__code__.co_filename, function.__code__.co_firstlineno, 1)
        return Entry(kind, mark, palp, ros, ros_type, convert, messages, to, qos or {})

    return decorate


def _messages(kind: Kind, function: Callable[..., Any], to: str) -> tuple[type[Message], ...]:
    """Return the classes of the graph's messages that a function is annotated with."""
    hints, name = get_type_hints(function), function.__name__
    first = next(iter(inspect.signature(function).parameters), "")
    annotated = {} if kind in ("from_ros2", "service") else {f"parameter '{first}'": hints.get(first)}
    returned = hints.get("return")
    if kind in ("service", "call"):
        if get_origin(returned) is not Generator or not inspect.isgeneratorfunction(function):
            raise GraphError(f"{name}: not a generator; annotate it with Generator[YIELDED, SENT, RETURNED]")
        yielded, sent, returned = get_args(returned)
        if kind == "service":
            annotated |= {"what it yields": yielded, "what it is sent": sent}
    if to or kind == "from_ros2":
        annotated["what it returns"] = returned
    found = [hint for hint in annotated.values() if isinstance(hint, type) and issubclass(hint, Message)]
    for what, hint in annotated.items():
        if hint not in found:
            raise GraphError(f"{name}: {what} is not a message of the graph; annotate it with its class")
    return tuple(found)


def _place(frame: Any) -> Mark:
    caller = frame.f_back
    return Mark(caller.f_code.co_filename, caller.f_lineno, 1)
