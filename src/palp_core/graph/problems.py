"""What is wrong in a launch file, and where: every mistake is collected, located and printed on one line."""

import difflib
from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from palp_core.errors import GraphError


class Mark(NamedTuple):
    """A place in a file; line and column count from 1."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


class Problem(msgspec.Struct, frozen=True, order=True):
    """One mistake: where it is, what is wrong and what to do."""

    file: str
    line: int
    column: int
    message: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}: {' '.join(self.message.split())}"


class GraphProblems(GraphError):
    """A launch file has mistakes, all of them listed."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))


class Problems:
    """Collects mistakes, so that all are reported at once."""

    def __init__(self, found: Iterable[Problem] = ()) -> None:
        self._found = list(found)

    def add(self, mark: Mark, message: str) -> None:
        self._found.append(Problem(*mark, message))

    def __len__(self) -> int:
        return len(self._found)

    def listed(self) -> tuple[Problem, ...]:
        """Return the mistakes in order, each once."""
        return tuple(sorted(set(self._found)))

    def raise_any(self) -> None:
        if self._found:
            raise GraphProblems(self._found)


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known name that is most like a word, or None when none is like it."""
    matches = difflib.get_close_matches(word, list(known), n=1)
    return matches[0] if matches else None


def hint(word: str, known: Iterable[str]) -> str:
    """Return what to do about an unknown name: the nearest known one, or the list of them.

    >>> hint("estimatr", ["torque", "estimator"])
    "; did you mean 'estimator'?"
    >>> hint("x", ["torque", "estimator"])
    '; there are: estimator, torque'
    """
    names = sorted(set(known))
    match = nearest(word, names)
    if match is not None:
        return f"; did you mean '{match}'?"
    return f"; there are: {', '.join(names)}" if names else "; there are none"
