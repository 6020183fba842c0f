"""Turn a bag into what other tools open.

Another form is a name here and a function, as in ``forms``.
"""

from contextlib import AbstractContextManager
from enum import StrEnum
from importlib import import_module
from pathlib import Path

from palp_core.errors import BagError
from palp_core.foreign import catch_foreign


class BagForm(StrEnum):
    """What a bag can become."""

    ROS2 = "ros2"
    JSON = "json"
    CSV = "csv"
    PARQUET = "parquet"


_WRITERS = {
    BagForm.ROS2: ("ros2.export_bag", "write"),
    BagForm.JSON: ("forms", "write_json"),
    BagForm.CSV: ("forms", "write_csv"),
    BagForm.PARQUET: ("forms", "write_parquet"),
}


def convert(bag: str | Path, out: str | Path, form: BagForm) -> int:
    """Write a bag in another form; return how many messages there are."""
    with writing(bag, out):
        module, function = _WRITERS[form]
        count: int = getattr(import_module(f"palp_core.graph.bag.{module}"), function)(bag, out)
    return count


def writing(bag: str | Path, out: str | Path) -> AbstractContextManager[object]:
    """Turn what goes wrong as a bag is written in another form into a BagError."""
    return catch_foreign(f"{out} cannot be written", BagError, f"it lacks a part of {bag}: remove it")
