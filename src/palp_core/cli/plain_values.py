"""What a verb's parameters are given, taken without the library by which Typer checks types.

To import that library, and to make a checker for each parameter of a verb, takes longer than all else before
the verb begins. Most of what is given needs neither: nothing at all, a text, a path, one of the choices.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Self, get_args, get_origin


class PlainValues:
    """Stands in a parameter's place for Typer's own way to turn what is given into what its function takes.

    Args:
        descriptor: Typer's description of the parameter: its ``annotation``, and ``parameter_info``.
        own: Makes Typer's own way.
    """

    def __init__(self, descriptor: Any, own: Callable[[], Any]) -> None:
        self._descriptor, self._own = descriptor, own

    def itself(self) -> Self:
        """Take the place of what makes Typer's own way."""
        return self

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return what the function takes; what is not plain goes Typer's way.

        Raises:
            typer.BadParameter: The value does not fit.
        """
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if self.is_plain(value, self._descriptor.annotation):
            return _taken(value, self._descriptor.annotation)
        return self._own().coerce(value, param=param, ctx=ctx)

    def is_plain(self, value: Any, kind: Any) -> bool:
        """Tell whether a value is what the annotation says: there is nothing to check or to compute."""
        info = self._descriptor.parameter_info
        if info.parser is not None:
            return False
        if get_origin(kind) is list:
            return isinstance(value, list | tuple) and all(
                self.is_plain(one, get_args(kind)[0]) for one in value
            )
        if get_origin(kind) is Literal:
            return value in get_args(kind)
        if kind is Path:
            looked_at = info.exists or info.writable or info.resolve_path or info.path_type is not None
            anything = info.file_okay and info.dir_okay and not looked_at
            return anything and (os.access(value, os.R_OK) or not os.path.exists(value))  # noqa: PTH110
        return type(value) is kind  # a number is palp's own default: what a user gives is text


def _taken(value: Any, kind: Any) -> Any:
    if get_origin(kind) is list:
        return [_taken(one, get_args(kind)[0]) for one in value]
    return Path(value) if kind is Path else value


def take_plainly(command: Any) -> Any:
    """Let a verb, or the verbs of a group, take plain values so; return it.

    A Typer that has another way keeps it.
    """
    own = command.get_params
    command.get_params = lambda context: [_plain(param) for param in own(context)]
    for verb in getattr(command, "commands", {}).values():
        take_plainly(verb)
    return command


def _plain(param: Any) -> Any:
    own = getattr(param, "get_runtime_param", None)
    if own is not None and not isinstance(own.__self__, PlainValues):
        param.get_runtime_param = PlainValues(param.type_descriptor, own).itself
    return param
