"""What does a declared method's work beside it is declared, too: the register leaves nothing out."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import FunctionType, ModuleType
from typing import Any

import pytest

from palp_core.methods import methods, tasks
from palp_core.palpation.mechanics.contact.model import BesideBead, ContactModel
from palp_core.palpation.perception.belief.stopping import StopRule
from palp_core.palpation.perception.strategy.policies import StiffnessPolicy

NO_METHOD = {
    ContactModel: "what rungs have in common",
    BesideBead: "a rung past a bead beside the path",
    StopRule: "what rules have in common",
    StiffnessPolicy: "what policies have in common",
}
"""What looks like a method and is none, and why."""


def room(targets: list[Any]) -> Iterator[ModuleType]:
    """Yield the modules beside those that declare methods."""
    for package in sorted({target.__module__.rpartition(".")[0] for target in targets}):
        found = importlib.import_module(package)
        for info in pkgutil.iter_modules(found.__path__):
            if not info.ispkg:
                yield importlib.import_module(f"{package}.{info.name}")


def face(kind: type) -> set[str]:
    return {name for name in dir(kind) if not name.startswith("_")}


def form(function: FunctionType) -> tuple[Any, ...]:
    """Return what a function takes and gives, names left out."""
    signature = inspect.signature(function)
    return (*(one.annotation for one in signature.parameters.values()), signature.return_annotation)


def undeclared(targets: list[Any]) -> list[str]:
    """Return the classes and functions that could stand for a task's methods and are not among them."""
    classes = [one for one in targets if isinstance(one, type)]
    common = set.intersection(*map(face, classes)) if classes else set()
    forms = {form(one) for one in targets if isinstance(one, FunctionType)}
    return [
        f"{module.__name__}:{name}"
        for module in room(targets)
        for name, one in vars(module).items()
        if getattr(one, "__module__", "") == module.__name__
        and (
            (isinstance(one, type) and common and common <= face(one))
            or (isinstance(one, FunctionType) and form(one) in forms)
        )
        and one not in (*targets, *NO_METHOD)
    ]


def targets_of(task: str) -> list[Any]:
    return [one.target for one in methods(task) if one.module.startswith("palp_core.")]


@pytest.mark.parametrize("task", [one.name for one in tasks()])
def test_nothing_that_could_be_a_method_is_outside_the_register(task: str) -> None:
    assert undeclared(targets_of(task)) == []
