"""Keys as they are pressed, where a person is at the keyboard; the terminal is as it was afterwards."""

from __future__ import annotations

import os
import sys
import termios
import tty
from typing import Any, Self

_NAMES = {"A": "up", "B": "down", "C": "right", "D": "left"}


class Keyboard:
    """Standard input key by key, if it is a terminal; Ctrl-C and Ctrl-Z keep their meaning.

    Attributes:
        file_descriptors: Become readable when a key was pressed; none without a terminal.
    """

    def __init__(self, *, wanted: bool = True) -> None:
        self.file_descriptors: tuple[int, ...] = ()
        self._wanted = wanted
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        if self._wanted and self.there():
            number = sys.stdin.fileno()
            self._before = termios.tcgetattr(number)
            tty.setcbreak(number)
            self.file_descriptors = (number,)
        return self

    @staticmethod
    def there() -> bool:
        """Tell whether somebody can press keys: a terminal, and this process not in its background."""
        if not sys.stdin.isatty():
            return False
        try:
            return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
        except OSError:  # a terminal that controls nobody has no background
            return True

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            termios.tcsetattr(self.file_descriptors[0], termios.TCSADRAIN, self._before)

    def read(self) -> list[str]:
        """Return the keys pressed: characters, and ``up``, ``down``, ``right``, ``left``.

        To be called when the descriptor is readable; a terminal that has gone has no keys any more.
        """
        try:
            text = os.read(self.file_descriptors[0], 256).decode(errors="ignore")
        except OSError:
            text = ""
        if not text:
            self.file_descriptors, self._before = (), None
        return keys_in(text)


def keys_in(text: str) -> list[str]:
    r"""Split what a terminal sends into keys.

    >>> keys_in(" \x1b[C1\x1bOA")
    [' ', 'right', '1', 'up']
    """
    keys, i = [], 0
    while i < len(text):
        if text[i] == "\x1b" and text[i + 1 : i + 2] in ("[", "O"):
            keys += [name] if (name := _NAMES.get(text[i + 2 : i + 3])) is not None else []
            i += 3
        else:
            keys.append(text[i])
            i += 1
    return keys
