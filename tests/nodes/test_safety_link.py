"""A safety node whose own link is gone goes on hearing and answering while it looks for another."""

from __future__ import annotations

import logging
import threading
from typing import Any

import pytest

from nodes import safety
from palp_core.errors import DeviceError
from palp_core.palpation.devices.link.reconnection import Reconnection
from tests.nodes.test_safety import ScriptedStop, Watched, sweeping

LONG_S = 60.0


def test_a_controller_that_neither_answers_nor_refuses_keeps_nobody_waiting(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    watched = Watched(monkeypatch)
    sweeping(watched)
    asked, answers = threading.Event(), threading.Event()
    second = ScriptedStop()
    second.report, second.asked_ns = watched.link.report, watched.link.asked_ns

    def connect(*_: Any, **__: Any) -> ScriptedStop:
        asked.set()
        assert answers.wait(LONG_S)
        return second

    monkeypatch.setattr(safety, "AerotechStop", connect)
    watched.link.broken = True
    with caplog.at_level(logging.WARNING):
        watched.run(0.5)
    assert asked.wait(LONG_S)
    assert watched.trips() == ["lost link"]
    assert watched.status.state == "stopping"
    assert sum("cannot be stopped" in line for line in caplog.text.splitlines()) <= 1
    answers.set()
    for _ in range(1000):
        watched.run(0.02)
        if watched.status.state == "latched":
            break
        threading.Event().wait(0.001)
    assert second.calls[:2] == ["abort", "disable"]
    watched.moving = False
    watched.run(0.02)
    assert watched.acknowledge().done


def test_a_connection_is_tried_until_there_is_one_and_given_to_one() -> None:
    refusals, made = [DeviceError("no"), DeviceError("no")], threading.Event()

    def connect() -> ScriptedStop:
        if refusals:
            raise refusals.pop()
        made.set()
        return ScriptedStop()

    again = Reconnection(connect, pause_s=0.0)
    assert again.fetch() is None
    assert again.start()
    assert not again.start()
    assert made.wait(LONG_S)
    found = None
    while found is None:
        found = again.fetch()
    assert again.fetch() is None
    assert found.calls == []


def test_a_connection_that_comes_after_the_end_is_closed() -> None:
    asked, answers, late = threading.Event(), threading.Event(), ScriptedStop()
    closed = threading.Event()
    late.close = closed.set  # type: ignore[method-assign]

    def connect() -> ScriptedStop:
        asked.set()
        assert answers.wait(LONG_S)
        return late

    again = Reconnection(connect)
    again.start()
    assert asked.wait(LONG_S)
    again.close()
    answers.set()
    assert closed.wait(LONG_S)
    assert not again.start()
