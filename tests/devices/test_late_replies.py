"""An answer that comes late is never taken for the answer to what was asked after it."""

from __future__ import annotations

import struct
import threading
from collections import deque
from typing import Any

import can
import pytest

from palp_core.devices import ati_session
from palp_core.devices.ati_session import AtiSession, RawSample
from palp_core.devices.emulator.netcanoem import Netcanoem
from palp_core.devices.emulator.world import World, WorldSettings
from palp_core.devices.health import Watch
from palp_core.devices.host_time import HostTime
from palp_core.devices.patience import Patience

BASE = 0x200


class HeldBus:
    """A bus with a sensor whose every sample says how many were asked for; it may hold back what it says."""

    def __init__(self, world: World) -> None:
        self._sensor = Netcanoem(world)
        self._queue: deque[can.Message] = deque()
        self._held: list[can.Message] = []
        self.holds, self.asked = False, 0

    def send(self, message: can.Message) -> None:
        if message.arbitration_id == BASE:
            self.asked += 1
            frames = [
                (BASE, struct.pack(">H3h", 0, self.asked, 0, 0)),
                (BASE + 1, struct.pack(">3h", 0, 0, 0)),
            ]
        else:
            frames = self._sensor.answer(message.arbitration_id, bytes(message.data), 0)
        answers = [can.Message(arbitration_id=i, data=data, is_extended_id=False) for i, data in frames]
        if self.holds:
            self._held += answers
        else:
            self._queue.extend(answers)

    def release(self) -> None:
        """Deliver what was held back."""
        self._queue.extend(self._held)
        self._held, self.holds = [], False

    def recv(self, timeout_s: float) -> can.Message | None:
        return self._queue.popleft() if self._queue else None

    def shutdown(self) -> None:
        return


def test_a_late_sample_makes_no_later_one_older(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(WorldSettings())
    bus = HeldBus(world)
    monkeypatch.setattr(ati_session, "_open_bus", lambda _: bus)
    samples: deque[RawSample] = deque()
    arguments: list[Any] = [{}, BASE >> 4, 0, 1000.0, 0.003, samples, Watch(0.025), HostTime(), 0, False]
    session, go_on = AtiSession(*arguments), threading.Event()
    for turn in range(12):
        bus.holds = turn in (3, 4)
        session.step(go_on)
        if turn == 4:
            bus.release()  # two samples late, as from a bus that was busy
    world.close()
    said = [struct.unpack(">H3h", first)[1] for _, _, _, first, _ in samples]
    assert said == [1, 2, 3, 6, 7, 8, 9, 10, 11, 12]


def test_time_in_which_the_reader_did_not_run_is_not_waited() -> None:
    now = [0.0]
    patience = Patience(0.1, 0.04, lambda: now[0])
    now[0] += 5.0  # stopped for 5 s, and the answer in the buffer since
    assert not patience.over()
    looks = 0
    while not patience.over():
        now[0] += 0.02
        looks += 1
    assert looks == 4
