"""Events of a graph and diagnostics of its nodes as entries of Foxglove's log."""

from typing import Any

from palp_core.errors import SchemaMismatch
from palp_core.graph.discovery.troubles import ERROR, OK, WARN, level_of
from palp_core.graph.messages.builtin import DiagnosticStatus, GraphEvent, NodeEvent
from palp_core.graph.messages.frame import Frame
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.spec import LAUNCHER

LOG = f"/{LAUNCHER}/log"
SCHEMA_NAME = "foxglove.Log"
SCHEMA: dict[str, Any] = {
    "title": SCHEMA_NAME,
    "description": "A log message",
    "type": "object",
    "properties": {
        "timestamp": {
            "title": "time",
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "level": {"type": "integer"},
        "message": {"type": "string"},
        "name": {"type": "string"},
        "file": {"type": "string"},
        "line": {"type": "integer"},
    },
}
"""Foxglove's well-known type, by whose name its Log panel finds the topic."""

RANKS = {OK: 2, WARN: 3, ERROR: 4}
_TYPES: dict[str, type[GraphEvent | NodeEvent | DiagnosticStatus]] = {
    schema_of(kind).hash_text: kind for kind in (GraphEvent, NodeEvent, DiagnosticStatus)
}


def is_logged(type_hash: str) -> bool:
    return type_hash in _TYPES


def entry_of(frame: Frame, type_hash: str) -> dict[str, Any] | None:
    """Return a message as an entry of the log; None if it is not one.

    >>> from palp_core.graph.messages.frame import Kind
    >>> from palp_core.graph.messages.message import encode
    >>> event = GraphEvent(stamp_ns=1_500_000_000, kind="failed", node="relay", text="it raised", data="{}")
    >>> frame = Frame("/graph/events", Kind.DATA, 0, 1, 1_500_000_000, 0, memoryview(encode(event)))
    >>> entry = entry_of(frame, schema_of(GraphEvent).hash_text)
    >>> entry["name"], entry["level"], entry["message"], entry["timestamp"]
    ('/relay', 4, 'failed: it raised', {'sec': 1, 'nsec': 500000000})
    """
    try:
        message = decode(_TYPES[type_hash], frame.payload)
    except (KeyError, SchemaMismatch):
        return None
    publisher = frame.topic.split("/")[1]
    match message:
        case GraphEvent(kind=kind, node=node, text=text):
            name, text = node or LAUNCHER, f"{kind}: {text}"
        case NodeEvent(kind=kind, text=text):
            name, text = publisher, f"{kind}: {text}"
        case DiagnosticStatus(level=level, text=text, advice=advice):
            name, text = publisher, "; ".join(part for part in (text, advice) if part) or level
    sec, nsec = divmod(frame.stamp_ns, 1_000_000_000)
    return {
        "timestamp": {"sec": sec, "nsec": nsec},
        "level": RANKS[level_of(message)],
        "message": text,
        "name": f"/{name}",
        "file": "",
        "line": 0,
    }
