"""The studies by name: what each asks, and the function that runs it."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from palp_core.errors import PalpError

__all__ = ["STUDIES", "Study", "study"]


@dataclass(frozen=True)
class Study:
    """A study.

    Attributes:
        name: As in ``palp study run NAME``.
        question: What it answers, in a line.
        target: ``module:function``, called as ``function(out, quick=...)``; returns its page.
    """

    name: str
    question: str
    target: str

    def run(self, out: Path, *, quick: bool = False) -> Path:
        """Run it and return its page."""
        module, _, name = self.target.partition(":")
        function: Callable[..., Path] = getattr(importlib.import_module(module), name)
        return function(out, quick=quick)


STUDIES = {
    one.name: one
    for one in (
        Study(
            "contact-stability",
            "Where does each method fail, by which symptom, and what survives there?",
            "palp_core.studies.contact_stability:run",
        ),
        Study(
            "contact-tradeoff",
            "What does each contact model cost, and how wrong is it?",
            "palp_core.studies.contact_tradeoff:run",
        ),
        Study(
            "contact-validity",
            "Are the stated bounds kept, and is the chosen model right enough, on random scenes?",
            "palp_core.studies.contact_validity:run",
        ),
    )
}


def study(name: str) -> Study:
    """Return a study by name.

    Raises:
        PalpError: There is none of that name.
    """
    if name not in STUDIES:
        raise PalpError(f"there is no study '{name}'; there are {', '.join(STUDIES)}")
    return STUDIES[name]
