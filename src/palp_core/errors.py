"""Every error palp raises on purpose.

::

    PalpError
    ├── GraphError            a launch file, an edge or an argument is wrong; a node failed to start
    ├── SchemaMismatch        two ends of an edge disagree about a type; bytes are not what they claim
    ├── LifecycleError        a transition that the node's state does not allow
    ├── GoalRejected          a node does not take a goal: raised by its @accept
    ├── CancelRejected        a node does not cancel a goal: raised by its @on_cancel
    ├── PublishTimeout        a reader made no room for a message in time (also a TimeoutError)
    ├── SecurityError         a key is missing, exposed to others or not accepted
    ├── NodeError             a node's handler raised, or its process ended
    ├── MethodError           no declared method meets a tolerance in a scene
    ├── MechanicsError        the mechanics have no valid answer here
    │   └── OutOfRange        an input outside a model's stated range
    ├── BagError              a bag is missing, exists already, or cannot be used as asked
    │   └── BagDamaged        its bytes are not what was written: truncated, flipped, torn
    ├── PerceptionError       a signal, prior or matrix that the computation cannot use
    └── DeviceError           a device refused, vanished or answered nonsense
        └── DeviceTimeout     it did not answer in time (also a TimeoutError)

A message says what is wrong, where, and what to do. Data rides as attributes.
"""

import re
from pathlib import Path


class PalpError(Exception):
    """Base of all of palp's own errors."""


class GraphError(PalpError):
    """A graph description or its start is wrong: unknown key, missing port, dangling input."""


class SchemaMismatch(PalpError):
    """Bytes or an edge do not fit a message type: other fields, other units, a value out of bounds."""


class LifecycleError(PalpError):
    """A lifecycle transition that is not allowed from the present state."""


class GoalRejected(PalpError):
    """A node does not take a goal of an action: raised by its ``@accept``; the client gets the text."""


class CancelRejected(PalpError):
    """A node does not cancel a goal now: raised by its ``@on_cancel``; the one who asked gets the text."""


class PublishTimeout(PalpError, TimeoutError):
    """A reader that the publisher waits for (``history: keep_all``) made no room in time; nothing was sent.

    Attributes:
        topic: What was to be published.
        reader: The reader that was furthest behind.
    """

    def __init__(self, topic: str, reader: str, message: str) -> None:
        super().__init__(message)
        self.topic = topic
        self.reader = reader


class SecurityError(PalpError):
    """A key is missing, exposed to others, malformed or not accepted by the other end."""


class NodeError(PalpError):
    """A node failed: an exception in a handler, a process that ended.

    Attributes:
        node: Running name of the node.
    """

    def __init__(self, node: str, message: str) -> None:
        super().__init__(f"{node}: {message}")
        self.node = node


class MethodError(PalpError):
    """No declared method meets the tolerance in this scene, or a method's name is unknown."""


class MechanicsError(PalpError):
    """The mechanics have no valid answer: no equilibrium, no contact law."""


class OutOfRange(MechanicsError):
    """An input lies outside the range a model is stated for.

    Attributes:
        quantity: Name of the quantity with its unit, as in ``indentation_m``.
    """

    def __init__(self, quantity: str, message: str) -> None:
        super().__init__(f"{quantity}: {message}")
        self.quantity = quantity


class PerceptionError(PalpError):
    """A signal, prior or matrix cannot be used: too short, all zero, not stochastic."""


class BagError(PalpError):
    """A bag is missing, exists already, or cannot be used as asked."""


class BagDamaged(BagError):
    """A bag's bytes are not what was written: truncated, flipped, torn.

    Attributes:
        path: The file.
        offset: Where in it, in bytes.
    """

    def __init__(self, path: Path, offset: int, message: str) -> None:
        super().__init__(f"{path}: at byte {offset}: {message}; `palp bag recover` saves what is intact")
        self.path = path
        self.offset = offset


class DeviceError(PalpError):
    """A device refused a command, vanished or sent what its protocol does not allow."""


class DeviceTimeout(DeviceError, TimeoutError):
    """A device did not answer in time."""


_MISFIT = re.compile(
    r"(?:Expected `(?P<wanted>.*?)`(?P<bound>.*?)(?:, got `?(?P<got>\w+)`?)?"
    r"|Object (?P<fault>missing|contains) .* `(?P<key>[^`]*)`|Invalid (?:enum )?value (?P<value>.*?))"
    r"(?: - at `(?:key` in `)?\$\.?(?P<place>.*)`)?"
)
_KINDS = {"int": "a whole number", "float": "a number", "str": "a text", "bool": "true or false"}
_KINDS |= {"array": "a list", "object": "a mapping"}
_BOUNDS = {">=": "at least", "<=": "at most", ">": "above", "<": "below"}


def in_words(error: BaseException) -> str:
    """Return what an error says, and its notes; palp's own messages are sentences, others need their type.

    >>> import msgspec
    >>> in_words(msgspec.ValidationError("Expected `float | null`, got `str` - at `$.rows[2].x_m`"))
    'rows[2].x_m must be a number or null, not a text'
    """
    said = str(error)
    if type(error).__module__ == "msgspec":  # asked by name: the import costs more than a short command
        said = _misfit(said)
    elif not isinstance(error, PalpError):
        said = f"{type(error).__name__}: {said}"
    return "; ".join([said, *getattr(error, "__notes__", ())])


def _misfit(text: str) -> str:
    found = _MISFIT.fullmatch(text)
    if found is None:
        return text
    place = found["place"] or ""
    if found["key"] is not None:
        key = f"{place}.{found['key']}".removeprefix(".")
        return f"{key} is missing" if found["fault"] == "missing" else f"there is no key {key}"
    if found["value"] is not None:
        return f"{place or 'it'} is {found['value']}, which is none of its choices"
    wanted = " or ".join(_KINDS.get(kind, kind) for kind in found["wanted"].split(" | "))
    bound = re.sub("^ (?=[<>]=)", " of ", found["bound"])
    bound = re.sub("([<>]=?) (\\S+)", lambda it: f"{_BOUNDS[it[1]]} {float(it[2]):,.15g}", bound)
    got = f", not {_KINDS.get(got, got)}" if (got := found["got"]) else ""
    return f"{place or 'it'} must be {wanted}{bound}{got}"
