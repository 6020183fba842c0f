"""Keys as they are pressed, where a person is at the keyboard; the terminal is as it was afterwards."""

import contextlib
import os
import sys
import termios
import tty
from typing import Any, Self, TypeGuard

_NAMES = {"A": "up", "B": "down", "C": "right", "D": "left"}


class Keyboard:
    """A terminal key by key; Ctrl-C and Ctrl-Z keep their meaning.

    ``file_descriptors`` become readable when a key was pressed; there is none where no one can press one.
    """

    def __init__(self, descriptor: int | None) -> None:
        self.file_descriptors: tuple[int, ...] = ()
        self._descriptor = descriptor
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        if attended(self._descriptor):
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
            self.file_descriptors = (self._descriptor,)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            with contextlib.suppress(termios.error, OSError):  # it may have gone meanwhile
                termios.tcsetattr(self.file_descriptors[0], termios.TCSADRAIN, self._before)
        self.file_descriptors, self._before = (), None

    def read(self) -> list[str]:
        """Return the keys pressed: characters, and ``up``, ``down``, ``right``, ``left``.

        To be called when the descriptor is readable; a terminal that has gone has no keys any more.
        """
        try:
            read = os.read(self.file_descriptors[0], 256)
        except OSError:
            read = b""
        if not read:
            self.file_descriptors, self._before = (), None
        return keys_in(read.decode(errors="ignore"))


def standard_input() -> int | None:
    """Return the descriptor of standard input if it is a terminal."""
    return sys.stdin.fileno() if sys.stdin.isatty() else None


def attended(descriptor: int | None) -> TypeGuard[int]:
    """Tell whether somebody can press keys: a terminal, and this process not in its background."""
    if descriptor is None or not os.isatty(descriptor):
        return False
    try:
        return os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:  # a terminal that controls no process has no background
        return True


def keys_in(text: str) -> list[str]:
    r"""Split what a terminal sends into keys; a space is one wherever it is, as it may stop a rig.

    >>> keys_in(" \x1b[C1\x1bOA")
    [' ', 'right', '1', 'up']
    >>> keys_in("\x1b[ ")
    [' ']
    """
    keys, i = [], 0
    while i < len(text):
        if text[i] == "\x1b" and text[i + 1 : i + 2] in ("[", "O"):
            keys += [name] if (name := _NAMES.get(text[i + 2 : i + 3])) is not None else []
            i += 2 if text[i + 2 : i + 3] == " " else 3
        else:
            keys.append(text[i])
            i += 1
    return keys
