"""Where methods of a task fail, as the stability studies measure it, over few values: for the words."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from palp_core.palpation.studies.contact.case import FailureCase
from palp_core.palpation.studies.contact.cases_joint import finder_cases
from palp_core.palpation.studies.contact.cases_other import contact_cases, friction_cases

_CASES: Mapping[str, Sequence[Callable[..., list[FailureCase]]]] = {
    "contact": (contact_cases,),
    "equilibrium": (finder_cases,),
    "friction": (friction_cases,),
}


def cases_of(task: str) -> Iterator[FailureCase]:
    """Return the cases of a task, as soon as each is measured."""
    for cases in _CASES.get(task, ()):
        yield from cases(quick=True)
