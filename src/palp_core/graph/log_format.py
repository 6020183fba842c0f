"""How nodes' log records are written: a level and a name at the beginning, and it is plain where one ends."""

import logging
from datetime import UTC, datetime

from palp_core.graph.clock import unix_ns

LEVELS = ("debug", "info", "warning", "error", "critical")
"""What a record may be, from the least on; ``critical``, Python's own ``fatal``, is for what ends a node."""

ENDING = {"ends_node": True}
"""``extra`` of the record with which a node ends: its first line says so."""

ENDS_NODE = " (this ends the node)"


class NodeFormatter(logging.Formatter):
    """Writes ``[LEVEL] [node]: text``; further lines, as of a traceback, are indented."""

    def __init__(self, node: str = "") -> None:
        super().__init__()
        self._node = node

    def format(self, record: logging.LogRecord) -> str:
        first, *more = super().format(record).split("\n")
        if hasattr(record, "ends_node"):
            first += ENDS_NODE
        text = "\n    ".join([first, *more])
        return f"[{record.levelname}] [{self.node_of(record)}]: {text}"

    def node_of(self, record: logging.LogRecord) -> str:
        return self._node or record.name.removeprefix("palp.")


class MergedFormatter(NodeFormatter):
    """Writes each line with time and node before it, as the merged log of nodes in processes has them."""

    def format(self, record: logging.LogRecord) -> str:
        head = f"{time_text()} {self.node_of(record)}: "
        return "\n".join(head + line for line in super().format(record).split("\n"))


def begin_log(node: str, level: str = "info") -> None:
    """Let everything that is logged or warned of in this process go to standard error as the node's."""
    handler = logging.StreamHandler()
    handler.setFormatter(NodeFormatter(node))
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    logging.captureWarnings(True)


def time_text() -> str:
    """Return the time as each line of the merged log has it."""
    return datetime.fromtimestamp(unix_ns() / 1e9, UTC).astimezone().isoformat(timespec="milliseconds")
