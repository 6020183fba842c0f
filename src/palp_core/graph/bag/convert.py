"""Turn a bag into what other tools open.

Another form is a name here and the module of that name in ``forms``, which has a function ``write``.
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


def convert(bag: str | Path, out: str | Path, form: BagForm) -> int:
    """Write a bag in another form; return how many messages there are.

    Args:
        bag: A bag's folder or one of its files.
        out: The new bag or the folder of tables, which must not exist.
        form: Which form.

    Raises:
        BagError: No such bag, ``out`` exists or cannot be written, or a library that the form needs is not
            installed.
        BagDamaged: The bag is damaged.
    """
    with writing(bag, out):
        count: int = import_module(f"palp_core.graph.bag.forms.{form}").write(bag, out)
    return count


def writing(bag: str | Path, out: str | Path) -> AbstractContextManager[object]:
    """Turn what goes wrong as a bag is written in another form into a BagError."""
    return catch_foreign(f"{out} cannot be written", BagError, f"it lacks a part of {bag}: remove it")
