"""A task of a lab's own: three methods, one of which fails, and a measure that may fail."""

import os
from collections.abc import Iterator
from typing import Any

from palp_core.methods import Bound, Method, Task
from palp_core.methods.measured import REFERENCE, Measured

TASKS = [
    Task(
        name="toy",
        question="How fast?",
        per="a toy",
        output="answer",
        tolerance=0.1,
        measure="toy_task:measure",
    )
]


def row(name: str, cost_s: float, *bounds: Bound, **more: Any) -> Method:
    place = f"toy_task:{name}"
    return Method(
        task="toy", name=name, place=place, cost_s=cost_s, bounds=bounds, evidence="toy_task.py", **more
    )


METHODS = [
    row("slow", 1.0, Bound("answer", 0.01)),
    row("quick", 0.1, Bound("answer", 0.05)),
    row("wrong", 0.01, fails="always", survivor="quick", reference="kept to show where it fails"),
]


def point(name: str, cost_s: float, error: float, **more: Any) -> Measured:
    return Measured("toy", name, more.pop("setting", ""), cost_s, error, "answer", "the truth", **more)


def measure(_scene: object) -> Iterator[Measured]:
    yield point("wrong", 0.02, float("nan"), fails="gave no answer")
    yield point("quick", 0.2, 0.9)
    yield point("quick", 0.2, 0.04)
    yield point("quick", 0.3, 0.2, setting="coarse", usual=False)
    match os.environ.get("TOY_TASK", ""):
        case "is interrupted":
            raise KeyboardInterrupt
        case "breaks":
            raise ZeroDivisionError("by nothing")
    yield point("slow", 2.0, 0.002)
    yield point("slow", 4.0, 0.0, setting="finest", usual=False, condition=REFERENCE)
