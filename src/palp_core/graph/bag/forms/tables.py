"""A bag as flat tables, one per topic: the rows, and where they go."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from palp_core.errors import BagError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.messages.schema_types import plain

HEAD = ("log_ns", "publish_ns", "epoch", "sequence")


def new_folder(out: str | Path) -> Path:
    """Make the folder of the tables.

    Raises:
        BagError: It exists.
    """
    folder = Path(out)
    try:
        folder.mkdir(parents=True)
    except FileExistsError as error:
        raise BagError(f"{folder} exists already: choose another name") from error
    return folder


def table_name(topic: str) -> str:
    """Return the file name of a topic's table, without ending."""
    return topic.strip("/").replace("/", ".") or "root"


def rows(bag: Bag) -> Iterator[tuple[str, dict[str, Any]]]:
    """Iterate messages as flat rows with their topic; a nested field is ``outer.inner``."""
    for message in bag.messages():
        row: dict[str, Any] = {name: getattr(message, name) for name in HEAD}
        for name, value in _flat(plain(message.value), ""):
            row[name if name not in row else f"message.{name}"] = value
        yield message.topic, row


def _flat(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat(inner, f"{path}.{name}" if path else name)
    else:
        yield path or "value", value
