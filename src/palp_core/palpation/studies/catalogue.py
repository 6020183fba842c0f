"""The studies by name: what each asks, and the function that runs it."""

import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palp_core.errors import PalpError
from palp_core.foreign import catch_foreign, import_foreign
from palp_core.published import STUDIES as PUBLISHED
from palp_core.published import published

OPTIONS = {"quick": False, "workers": 1, "dask": "", "sessions": 0}
"""What a study's function may take, and the usual value of each."""


@dataclass(frozen=True)
class Study:
    """A study."""

    name: str  # as in palp study run NAME
    question: str  # what it answers, in a line
    target: str  # module:function, called with the options that it takes; returns its page

    def run(self, out: Path, **options: Any) -> Path:
        """Run it and return its page."""
        module, _, name = self.target.partition(":")
        function: Callable[..., Path] = getattr(importlib.import_module(module), name)
        taken = inspect.signature(function).parameters
        if unknown := [f"--{option}" for option in options if option not in taken]:
            raise PalpError(f"the study '{self.name}' does not take {', '.join(unknown)}; leave it out")
        return function(out, **{name: value for name, value in (OPTIONS | options).items() if name in taken})


STUDIES = {
    one.name: one
    for one in (
        Study(
            "frontier",
            "What does a decision cost in seconds of the rig: peak, contrast, whole trace, in two worlds?",
            "palp_core.palpation.studies.frontier.study:run",
        ),
        Study(
            "paper",
            "Does a probe that varies its stiffness as humans do find nodules better? The paper, re-run.",
            "palp_core.palpation.studies.paper.study:run",
        ),
        Study(
            "robustness",
            "Do the results hold for other gels, rigs, contact models, trainings and human chains?",
            "palp_core.palpation.studies.robustness.study:run",
        ),
        Study(
            "search",
            "Is there a nodule, where, how deep, how sure? Speed against accuracy of searches in the plane.",
            "palp_core.palpation.studies.search.study:run",
        ),
        Study(
            "stability",
            "Where does each method of touch, belief and signals fail, by which symptom, and what survives?",
            "palp_core.palpation.studies.stability.study:run",
        ),
    )
}


def study(name: str) -> Study:
    """Return a study by name."""
    if name in STUDIES:
        return STUDIES[name]
    if name not in (known := published(PUBLISHED)):
        raise PalpError(f"there is no study '{name}'; there are {', '.join([*STUDIES, *known])}")
    return _published(name, known[name])


def studies() -> dict[str, Study]:
    """Return palp's own studies, then those that packages publish; what cannot be loaded says so."""
    found = dict(STUDIES)
    for name, target in published(PUBLISHED).items():
        if name not in found:
            try:
                found[name] = _published(name, target)
            except PalpError as error:
                found[name] = Study(name, str(error), target)
    return found


def _published(name: str, target: str) -> Study:
    """Return a study of another package: what it asks is the first line of its function's docstring."""
    function = import_foreign(target, f"study '{name}'", PalpError)
    with catch_foreign(f"study '{name}', {target}", PalpError):
        inspect.signature(function)
    question = (inspect.getdoc(function) or "no docstring says what it asks").partition("\n")[0]
    return Study(name, question, target)
