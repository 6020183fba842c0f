"""A trap of the published algorithm: the smallest input that springs it, the naive way, and ours."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Trap:
    """One trap.

    Attributes:
        name: As in T1.
        about: What it is about.
        input: The input in words.
        naive_way: What the naive method is.
        our_way: What ours is.
        naive: The naive method on that input.
        ours: Ours on the same input.
        survives: Whether an answer, or the error raised instead, is one to go on with.
        says: What an answer is, in words.
    """

    name: str
    about: str
    input: str
    naive_way: str
    our_way: str
    naive: Callable[[], Any]
    ours: Callable[[], Any]
    survives: Callable[[Any], bool]
    says: Callable[[Any], str]

    def words(self, found: Any) -> str:
        """Return an answer, or the error raised instead, in words."""
        return f"{type(found).__name__}: {found}" if isinstance(found, Exception) else self.says(found)


def answer(way: Callable[[], Any]) -> Any:
    """Return what a method answers; an error that it raises is its answer too, and no warning is shown."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            return way()
        except Exception as error:  # noqa: BLE001  whatever the naive way runs into is what is to be shown
            return error
