"""A process that is killed or stopped: another one stops its device, and the watch notices."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import psutil
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.contract import Subject
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.link import guard_process
from palp_core.palpation.devices.link.guard import LinkGuard
from palp_core.palpation.devices.link.guard_process import NAME as GUARD
from palp_core.palpation.devices.link.serial_link import SerialLink
from palp_core.palpation.devices.safety.process_watch import ProcessWatch
from palp_core.palpation.devices.stage.aerotech_stop import AerotechStop
from palp_core.palpation.devices.unverified import UnverifiedWarning
from tests.support.palp import ROOT

OWNER = """
import signal, sys
from palp_core.palpation.devices.link.guard import LinkGuard

guard = LinkGuard("stage", int(sys.argv[1]), [(0.0, b"ABORT\\n"), (0.01, b"DISABLE\\n")])
print(guard.pid, flush=True)
signal.pause()
"""


@pytest.fixture
def link() -> Iterator[tuple[socket.socket, socket.socket]]:
    device, ours = socket.socketpair()
    device.settimeout(60.0)
    with device, ours:
        yield device, ours


def everything_written(device: socket.socket) -> bytes:
    """Return what was written until all others have closed the link."""
    shown = b""
    while more := device.recv(1000):
        shown += more
    return shown


def test_a_killed_process_is_spoken_for_though_its_group_is_killed_with_it(
    link: tuple[socket.socket, socket.socket],
) -> None:
    device, ours = link
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, str(ours.fileno())],
        pass_fds=[ours.fileno()], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        start_new_session=True, env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
    )  # fmt: skip
    assert owner.stdout is not None
    guard = int(owner.stdout.readline())
    ours.close()
    os.kill(guard, signal.SIGTERM)  # it ends with its owner only
    os.killpg(owner.pid, signal.SIGKILL)
    owner.communicate()
    assert everything_written(device) == b"ABORT\nDISABLE\n"


def test_who_lets_go_of_the_link_is_not_spoken_for(link: tuple[socket.socket, socket.socket]) -> None:
    device, ours = link
    guard = LinkGuard("stage", ours.fileno(), [(0.0, b"ABORT\n")])
    assert guard.alive
    ours.close()
    guard.release()
    assert everything_written(device) == b""
    guard.release()  # once more is no harm


def test_a_guard_that_is_gone_is_missed_and_one_that_is_stopped_is_noticed(
    link: tuple[socket.socket, socket.socket], wait: Any
) -> None:
    guard = LinkGuard("stage", link[1].fileno(), [])
    processes = ProcessWatch(parent=os.getppid(), own=os.getpid())
    processes.refresh()
    assert psutil.Process(guard.pid).name() == guard_process.NAME
    os.kill(guard.pid, signal.SIGSTOP)
    wait.until(lambda: guard.pid in processes.stopped())
    os.kill(guard.pid, signal.SIGKILL)
    wait.until(lambda: not guard.alive)
    guard.release()


def test_a_link_that_no_other_process_can_hold_is_not_guarded_and_that_is_reported(
    quick_rig: Callable[..., EmulatedRig], monkeypatch: pytest.MonkeyPatch
) -> None:
    port = SerialLink("stage", "loop://", 115200)
    assert not port.guard([])
    port.close()
    monkeypatch.setattr(SerialLink, "guard", lambda *_: False)
    with pytest.warns(UnverifiedWarning, match="cannot be shared with a guard"):
        stop = AerotechStop(quick_rig("aerotech").stop_link, timeout_s=30.0)
    assert not stop.guarded
    stop.close()


def kill_guards() -> None:
    for child in psutil.Process().children():
        if child.name() == guard_process.NAME:
            child.kill()


def test_a_stage_whose_guard_is_gone_stops_and_goes_on_with_another_once_it_is_opened_again(
    quick_rig: Callable[..., EmulatedRig], driver: Callable[..., Subject]
) -> None:
    rig = quick_rig("aerotech")
    stage = driver(rig, "aerotech", return_speed_m_per_s=0.005)
    stage.call("return_to", -0.05)
    kill_guards()
    stage.until(lambda: stage.device.health(stage.now()).condition == "link lost", "a lost link")
    assert "guard" in stage.device.health(stage.now()).cause
    y = rig.call(rig.axes.y.position_m)
    assert y > -0.045  # it did not come to the end of its way
    stage.until(lambda: rig.call(lambda now_ns: not rig.axes.y.moving(now_ns)), "rest")
    stage.device.close()
    stage.call("open")
    assert stage.device.health(stage.now()).ok


def test_a_second_link_whose_guard_is_gone_is_lost(quick_rig: Callable[..., EmulatedRig], wait: Any) -> None:
    stop = AerotechStop(quick_rig("aerotech").stop_link, timeout_s=30.0, look_hz=200.0)
    assert stop.guarded
    kill_guards()

    def lost() -> bool:
        try:
            stop.reports()
        except DeviceError as error:
            return "guard" in str(error)
        return False

    wait.until(lost)
    with pytest.raises(DeviceError, match="lost"):
        stop.abort()
    stop.close()


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
