"""A process that was stopped by a signal is noticed among the children of one parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import psutil
import pytest

from palp_core.palpation.devices.link.guard_process import NAME as GUARD
from palp_core.palpation.devices.safety.process_watch import ProcessWatch


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    yield process
    process.kill()
    process.communicate()


def test_a_stopped_child_is_noticed_until_it_continues(sleeper: subprocess.Popen[bytes], wait: Any) -> None:
    processes = ProcessWatch(parent=os.getpid(), own=0)
    processes.refresh()
    assert sleeper.pid not in processes.stopped()
    sleeper.send_signal(signal.SIGSTOP)
    wait.until(lambda: psutil.Process(sleeper.pid).status() == psutil.STATUS_STOPPED)
    assert sleeper.pid in processes.stopped()
    sleeper.send_signal(signal.SIGCONT)
    wait.until(lambda: sleeper.pid not in processes.stopped())


def test_a_child_that_has_ended_is_not_stopped(sleeper: subprocess.Popen[bytes]) -> None:
    processes = ProcessWatch(parent=os.getpid(), own=0)
    processes.refresh()
    sleeper.kill()
    sleeper.wait()
    assert sleeper.pid not in processes.stopped()


def test_a_child_that_ends_is_missed(sleeper: subprocess.Popen[bytes], wait: Any) -> None:
    processes = ProcessWatch(parent=os.getpid(), own=0)
    processes.refresh()
    assert processes.ended() == []
    sleeper.kill()
    wait.until(lambda: psutil.Process(sleeper.pid).status() == psutil.STATUS_ZOMBIE)
    assert processes.ended() == [sleeper.pid]
    assert processes.ended() == []


def test_a_child_that_hands_over_to_another_is_not_missed(sleeper: subprocess.Popen[bytes]) -> None:
    processes = ProcessWatch(parent=os.getpid(), own=0)
    processes.refresh()
    following = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    processes.refresh()
    sleeper.kill()
    sleeper.wait()
    assert processes.ended() == []
    following.kill()
    following.communicate()
    assert processes.ended() == [following.pid]


def test_a_guard_that_is_left_behind_is_for_no_node(sleeper: subprocess.Popen[bytes], wait: Any) -> None:
    processes = ProcessWatch(parent=os.getpid(), own=0)
    processes.refresh()
    left = subprocess.Popen(
        [sys.executable, "-c", f"open('/proc/self/comm', 'w').write({GUARD!r}); input()"],
        stdin=subprocess.PIPE,
    )
    wait.until(lambda: psutil.Process(left.pid).name() == GUARD)
    sleeper.kill()
    wait.until(lambda: psutil.Process(sleeper.pid).status() == psutil.STATUS_ZOMBIE)
    assert processes.ended() == [sleeper.pid]
    left.kill()
    left.communicate()
