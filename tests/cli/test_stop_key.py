"""The key that stops: heard on a terminal, and the terminal is as before afterwards."""

from __future__ import annotations

import os
import queue
import termios
from collections.abc import Iterator

import pytest

from palp_core.cli.launch.stop_key import KEY, StopKey


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    master, slave = os.openpty()
    yield master, slave
    os.close(master)
    os.close(slave)


def test_each_press_is_heard_and_other_keys_are_not(terminal: tuple[int, int]) -> None:
    master, slave = terminal
    presses: queue.Queue[str] = queue.Queue()
    key = StopKey(slave, lambda: presses.put("pressed"))
    assert key.start()
    os.write(master, b"x")
    os.write(master, KEY)
    assert presses.get(timeout=60.0) == "pressed"
    key.stop()
    assert presses.empty()


def test_the_terminal_is_as_before(terminal: tuple[int, int]) -> None:
    _, slave = terminal
    before = termios.tcgetattr(slave)
    key = StopKey(slave, lambda: None)
    key.start()
    assert not termios.tcgetattr(slave)[3] & termios.ICANON
    key.stop()
    assert termios.tcgetattr(slave) == before


def test_without_a_terminal_there_is_no_key() -> None:
    read, write = os.pipe()
    try:
        key = StopKey(read, lambda: None)
        assert not key.start()
        key.stop()
    finally:
        os.close(read)
        os.close(write)
