"""Commands for when several graphs run, about the nodes of :mod:`tests.support.talkative`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from palp_core.graph.discovery import running_graph

READING: tuple[tuple[str, ...], ...] = (
    ("node", "list"),
    ("node", "info", "source"),
    ("topic", "list"),
    ("topic", "info", "/source/sample"),
    ("service", "list"),
    ("param", "list"),
    ("param", "get", "source", "rate_hz"),
    ("param", "describe", "source"),
    ("param", "dump", "source"),
    ("lifecycle", "get"),
    ("lifecycle", "list", "source"),
)
CHANGING: tuple[tuple[str, ...], ...] = (
    ("param", "set", "source", "rate_hz", "50.0"),
    ("lifecycle", "set", "source", "deactivate"),
    ("lifecycle", "set", "source", "activate"),
    ("service", "call", "/scale/weigh", "{factor: 2}"),
    ("topic", "pub", "--once", "/scale/load", "{load_n: 1, samples: []}"),
    ("swap", "source", "--reload"),
)
SAFETY = (("stop",), ("safety", "ack"))
UNASKED = {("node", "list"), ("topic", "list")}
"""Verbs that know the answer from the graph's record."""


class Asked(NamedTuple):
    """A request: the run it went to, by its id, and what it asked."""

    run: str
    operation: str


FIELDS = {"factor": {"type": "integer"}, "load_n": {"type": "number"}, "samples": {"type": "array"}}
SCHEMA: dict[str, Any] = {"title": "Any", "type": "object", "properties": FIELDS}
PORT = {"types": [{"json_schema": SCHEMA}] * 2}
NUMBER = {"type": "float", "value": 1.0, "default": 1.0}
INFO = {
    **{part: {} for part in ("params", "published", "inputs", "outputs", "clients", "timers")},
    **{"name": "source", "run": "nodes.talk:Source", "pid": 1, "lifecycle": "active", "swaps": []},
    "services": {"weigh": ["WeighRequest", "WeighReply"]},
    "external": ["load"],
}
REPLIES: dict[str, dict[str, Any]] = {
    "info": INFO,
    "get_parameters": {"parameters": {"rate_hz": 1.0}},
    "set_parameters": {"parameters": {"rate_hz": 50.0}},
    "describe_parameters": {"parameters": {"rate_hz": NUMBER}},
    "transition": {"lifecycle": "inactive"},
    "schemas": {"ports": {"weigh": PORT, "load": PORT}},
    "call": {"reply": {"state": "latched", "cause": "operator", "done": True, "text": "", "warning": ""}},
    "publish": {"sequence": 1},
    "swap": {"failed": {"node": "source", "step": "check", "text": "not now"}},
}


Ask = Callable[[str, dict[str, Any], float], dict[str, Any] | None]


def noted(monkeypatch: pytest.MonkeyPatch, answer: Ask = running_graph._ask) -> list[Asked]:
    """Let requests be answered so; return where each was sent, as it comes."""
    asked: list[Asked] = []

    def ask(endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        asked.append(Asked(Path(endpoint.removeprefix("ipc://")).parent.name, request["op"]))
        return answer(endpoint, request, timeout_s)

    monkeypatch.setattr(running_graph, "_ask", ask)
    return asked


def answered_by_nobody(monkeypatch: pytest.MonkeyPatch) -> list[Asked]:
    """Let requests be answered without nodes; return where each was sent, as it comes."""
    return noted(monkeypatch, lambda _, request, __: REPLIES[request["op"]])
