"""The sensor's driver: a late answer is never the next one's, plain numbers give what arrays would."""

from __future__ import annotations

import struct
import threading
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace

import can
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nodes.rig_torque import _largest
from palp_core.errors import DeviceTimeout
from palp_core.palpation.devices.emulator.netcanoem import Netcanoem
from palp_core.palpation.devices.health import HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.reply_timeout import ReplyTimeout
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.palpation.devices.torque.ati import AtiState, AtiTorque
from palp_core.palpation.devices.torque.ati_session import AtiSession, RawSample, SensorCalibration
from palp_core.palpation.devices.wire import netcanoem

BASE = 0x200
PROMPT_NS = 300_000
LONGEST_MS = 200


class LateBus:
    """A bus with a sensor whose every sample says how many were asked for, on a clock of its own.

    Args:
        late_ns: How long the reply to each request is held back; None loses it.
    """

    def __init__(self, late_ns: Callable[[int], int | None]) -> None:
        self._sensor, self._late_ns = Netcanoem(lambda _: [0.0] * 6), late_ns
        self._due: deque[tuple[int, can.Message]] = deque()
        self.now_ns, self.asked, self._last_due_ns = 1_000_000_000, 0, 0
        self.asked_ns: dict[int, int] = {}

    def send(self, message: can.Message) -> None:
        late_ns: int | None = 0
        if message.arbitration_id == BASE:
            self.asked += 1
            self.asked_ns[self.asked] = self.now_ns
            frames = [
                (BASE, struct.pack(">H3h", 0, self.asked, 0, 0)),
                (BASE + 1, struct.pack(">3h", 0, 0, 0)),
            ]
            late_ns = self._late_ns(self.asked)
        else:
            frames = self._sensor.answer(message.arbitration_id, bytes(message.data), 0)
        if late_ns is None:
            return
        self._last_due_ns = max(self._last_due_ns, self.now_ns + PROMPT_NS + late_ns)  # a bus keeps order
        for i, data in frames:
            answer = can.Message(arbitration_id=i, data=data, is_extended_id=False)
            self._due.append((self._last_due_ns, answer))

    def recv(self, timeout_s: float) -> can.Message | None:
        until_ns = self.now_ns + round(timeout_s * 1e9)
        if self._due and self._due[0][0] <= until_ns:
            due_ns, message = self._due.popleft()
            self.now_ns = max(self.now_ns, due_ns)
            return message
        self.now_ns = until_ns
        return None

    def shutdown(self) -> None:
        return


class BusHost(HostTime):
    """The host on the clock of the bus."""

    def __init__(self, bus: LateBus) -> None:
        super().__init__()
        self._bus = bus

    def now_ns(self) -> int:
        return self._bus.now_ns


class BusTime(threading.Event):
    """Waiting is the passing of the bus's time."""

    def __init__(self, bus: LateBus) -> None:
        super().__init__()
        self._bus = bus

    def wait(self, timeout: float | None = None) -> bool:
        self._bus.now_ns += round((timeout or 0.0) * 1e9)
        return False


class Polled:
    """A session on a late bus: how old each sample was when it was kept, and the driver's health."""

    def __init__(
        self,
        late_ns: Callable[[int], int | None],
        rate_hz: float = 1000.0,
    ) -> None:
        self.bus = bus = LateBus(late_ns)
        self.samples: deque[RawSample] = deque()
        self.watch = HealthMonitor(0.025)
        self.session = AtiSession(
            bus,
            BASE >> 4,
            0,
            rate_hz,
            0.003,
            self.samples,
            self.watch,
            BusHost(bus),
            0,
            False,
            clock=lambda: bus.now_ns * 1e-9,
        )
        self.watch.note_data(bus.now_ns)
        self.ages_ns: dict[int, int] = {}
        self._time = BusTime(bus)

    def run(self, seconds: float) -> None:
        end_ns = self.bus.now_ns + round(seconds * 1e9)
        while self.bus.now_ns < end_ns:
            self.session.step(self._time)
            while self.samples:
                number = self.samples.popleft()[4][0]
                self.ages_ns[number] = self.bus.now_ns - self.bus.asked_ns[number]


@pytest.mark.parametrize("rate_hz", [0.0, 100.0, 1000.0])
@pytest.mark.parametrize("late_ms", [3, 9, 11, 13, 20, 40, 100, 240])
def test_a_steady_delay_never_passes_for_fresh(late_ms: int, rate_hz: float) -> None:
    polled = Polled(lambda count: late_ms * 1_000_000 if 20 < count < 60 else 0, rate_hz=rate_hz)
    polled.run(0.3)
    polled.run(40 * (late_ms + 20) * 1e-3 + 0.3)
    assert polled.bus.asked > 60
    assert polled.watch.read(polled.bus.now_ns).ok, "the delay is over"
    longest_ms = 1e3 * (2.0 * (max(1.0 / rate_hz, 0.002) if rate_hz else 0.005) + 0.008)
    assert max(polled.ages_ns.values()) <= longest_ms * 1e6 + PROMPT_NS
    if late_ms > longest_ms:
        assert not set(range(21, 60)) & set(polled.ages_ns)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(late_ms=st.lists(st.one_of(st.just(0), st.integers(0, LONGEST_MS), st.none()), max_size=60))
def test_whatever_is_late_or_lost_no_sample_is_older_than_12_ms(late_ms: list[int | None]) -> None:
    def late_ns(count: int) -> int | None:
        late = late_ms[count - 1] if count <= len(late_ms) else 0
        return None if late is None else late * 1_000_000

    polled = Polled(late_ns)
    try:
        polled.run(2.0)
    except DeviceTimeout:  # two in a row were lost, and nothing else was on its way
        assert None in late_ms
    assert max(polled.ages_ns.values(), default=0) <= 12_000_000 + PROMPT_NS


def test_time_in_which_the_reader_did_not_run_is_not_waited() -> None:
    now = [0.0]
    timeout = ReplyTimeout(0.1, 0.04, lambda: now[0])
    now[0] += 5.0  # stopped for 5 s, and the answer in the buffer since
    assert not timeout.expired()
    looks = 0
    while not timeout.expired():
        now[0] += 0.02
        looks += 1
    assert looks == 4


loads = st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6)
strange = st.lists(st.floats(width=64), min_size=6, max_size=6)
words = st.integers(-32768, 32767)


@settings(deadline=None, max_examples=25)
@given(
    bias=loads,
    values=st.lists(st.tuples(words, words, words, words, words, words), min_size=1, max_size=8),
    status=st.sampled_from([0, netcanoem.CRITICAL]),
    sign=st.sampled_from([1, -1]),
)
def test_a_block_of_any_samples_is_that_of_arrays(
    bias: list[float], values: list[tuple[int, ...]], status: int, sign: int
) -> None:
    sensor, state = AtiTorque(axis="y", sign=sign), AtiState(bias)
    matrix = np.random.default_rng(0).uniform(-1e-5, 1e-5, (6, 6))
    sensor._session = SimpleNamespace(calibration=SensorCalibration(matrix, "", (3, 8, 1)))  # type: ignore[assignment]
    sensor._samples.extend((1000 * k, 7 + k, k == 0, status, row) for k, row in enumerate(values))
    got = sensor.drain(0, state, np.random.default_rng(0))
    wrench = np.array(values) @ matrix.T - np.array(bias)
    saturated = np.isin(np.array(values), netcanoem.SATURATED).any(axis=1)
    torque_n_m = np.where(saturated, np.clip(sign * wrench[:, 4], -0.12, 0.12), sign * wrench[:, 4])
    np.testing.assert_allclose(got.wrench, wrench, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(got.torque_n_m, torque_n_m, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(got.faulty, saturated | (status != 0))
    assert got.saturated_count == np.count_nonzero(saturated)
    assert state.sample_count == 7 + len(values)
    assert (got.index.tolist()[0], got.gap.tolist()[0]) == (7, True)


@settings(deadline=None, max_examples=25)
@given(rows=st.lists(strange, max_size=8), one_axis=st.booleans())
def test_the_largest_load_of_any_rows_is_that_of_arrays(rows: list[list[float]], one_axis: bool) -> None:
    wrench = np.array(rows).reshape(-1, 6)
    torque_n_m = wrench[:, 3].copy()
    if one_axis:
        wrench[:, [0, 1, 2, 4, 5]] = 0.0
    broken = ~np.isfinite(wrench).all(axis=1)
    sizes = np.abs(np.where(broken[:, np.newaxis], 0.0, wrench))
    published = TorqueSamples(
        np.arange(len(rows)), torque_n_m, 0, wrench=np.empty((0, 6)) if one_axis else wrench
    )
    expected = np.max(sizes[:, 3:], initial=0.0), np.max(sizes[:, :3], initial=0.0), broken.tolist()
    assert _largest(published) == expected


@settings(deadline=None, max_examples=25)
@given(status=st.integers(0, 65535), values=st.tuples(words, words, words, words, words, words))
def test_two_frames_have_six_gauges_in_order(status: int, values: tuple[int, ...]) -> None:
    first = np.array(values[0::2], ">i2").tobytes()
    second = np.array(values[1::2], ">i2").tobytes()
    assert netcanoem.gauges(status.to_bytes(2, "big") + first, second) == (status, values)
