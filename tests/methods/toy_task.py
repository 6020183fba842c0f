"""A task of a lab's own: three methods, one of which fails, and a measure that may fail."""

import os
from collections.abc import Iterator
from typing import Any

from palp_core.methods import Bound, declare_task, method
from palp_core.methods.measured import REFERENCE, Measured

declare_task("toy", "How fast is a toy?", per="a toy", output="answer", tolerance=0.1)


@method(task="toy", name="slow", cost_s=1.0, bounds=[Bound("answer", 0.01)], evidence="toy_task.py")
def slow() -> None: ...


@method(task="toy", name="quick", cost_s=0.1, bounds=[Bound("answer", 0.05)], evidence="toy_task.py")
def quick() -> None: ...


@method(
    task="toy", name="wrong", cost_s=0.01, evidence="toy_task.py", fails="always", survivor="quick",
    reference="kept to show where it fails",
)  # fmt: skip
def wrong() -> None: ...


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
