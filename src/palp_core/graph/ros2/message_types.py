"""ROS 2's message types by name: the standard ones, and those with a ``.msg`` file in an installation."""

from __future__ import annotations

import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

from palp_core.errors import BagError, GraphError
from palp_core.foreign import catch_foreign
from palp_core.graph.bag.ros2.definitions import Definitions, field_types, standard
from palp_core.graph.problems import hint


@cache
def known_types() -> Definitions:
    """Return the types of this process: the standard ones, and those that :func:`message_type` has found."""
    return standard()


def message_type(name: str, folder: str | Path = "") -> Any:
    """Return the dataclass of a ROS 2 message type; a field that is not given is zero or empty.

    >>> message_type("geometry_msgs/msg/Vector3")(x=1.5).y
    0.0

    Args:
        name: As ROS 2 has it: ``geometry_msgs/msg/Wrench``.
        folder: Where ``PACKAGE/msg/NAME.msg`` is, for a type that is not installed. Installations of ROS 2
            (``AMENT_PREFIX_PATH``) and the present Python's are searched, too.

    Raises:
        GraphError: There is no such type, or it cannot be read; the nearest name is in the message.
    """
    types = known_types()
    try:
        if name not in types:
            types.add(_definitions(name, folder))
        return types.message_class(name)
    except BagError as error:
        raise GraphError(str(error)) from error


def _definitions(name: str, folder: str | Path) -> dict[str, str]:
    """Return the texts of a type and of what it needs, by name, of those that are not known."""
    texts: dict[str, str] = {}
    wanted = [name]
    while wanted:
        one = wanted.pop()
        if one not in known_types() and one not in texts:
            texts[one] = _text(one, folder)
            wanted += _parts(one, texts[one])
    return texts


def _text(name: str, folder: str | Path) -> str:
    roots = [
        Path(root) / "share" for root in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if root
    ]
    for place in (*([Path(folder)] if folder else []), *roots, Path(sys.prefix) / "share"):
        file = place / f"{name}.msg"
        try:
            return file.read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError):
            continue
        except (OSError, UnicodeDecodeError) as error:
            raise GraphError(f"{file} cannot be read: {error}") from error
    raise GraphError(
        f"no message type '{name}' is known{hint(name, known_types().names)[:200]}; "
        "message_type(NAME, FOLDER) finds FOLDER/PACKAGE/msg/NAME.msg"
    )


def _parts(name: str, text: str) -> list[str]:
    from rosbags.typesys import get_types_from_msg

    with catch_foreign(f"{name}: its definition cannot be read", GraphError):
        found = get_types_from_msg(text, name)
    return [kind.base for kind in field_types(found[name][1]).values() if kind.is_message]
