"""An ATI NETCANOEM behind a socketcand server, with the bus's own pace."""

import struct
from collections.abc import Callable
from dataclasses import replace
from operator import mul

import numpy as np

from palp_core.palpation.devices.emulator.axis import Axes
from palp_core.palpation.devices.emulator.contact import ProbeContact
from palp_core.palpation.devices.sim.torque import SimTorque, SimTorqueState
from palp_core.units import Float64Array

NANO17_N_PER_V = np.array(
    [
        [-0.00458, -0.00979, 0.03928, -1.58147, -0.02651, 1.57113],
        [-0.00440, 2.11251, 0.02948, -0.93552, 0.00504, -0.90799],
        [1.84054, 0.00239, 1.88264, -0.05335, 1.89681, -0.04189],
        [0.04046, 12.81517, 10.73979, -5.99236, -10.65846, -5.25977],
        [-11.68856, -0.00616, 6.09687, 9.46016, 6.41318, -9.68378],
        [-0.02776, 8.47642, -0.06629, 7.73309, -0.17538, 7.63648],
    ]
)
"""Calibration of a real Nano17 SI-12-0.12: N and N mm per volt of each gauge."""

_WIDE_N_M = 10.0  # the gauges of the wire have the range, and the steps
_BASE = 0x20 << 4  # bits 4 to 10 of its identifiers
_COUNTS_PER_VOLT = 3276.8
_COUNTS_PER_UNIT = 1_000_000
_BITS = {0: 47, 1: 57, 2: 67, 6: 107, 8: 127}  # a frame with about a tenth of stuffing, and its gap


class LoadedSensor:
    """Forces and torques at the sensor, of which the simulated one says the torque about x."""

    def __init__(
        self, torque: SimTorque, force_noise_sd_n: float, contact: ProbeContact, axes: Axes, seed: int
    ) -> None:
        self._torque = replace(torque, resolution_n_m=0.0, range_n_m=_WIDE_N_M)
        self._contact, self._axes = contact, axes
        self._state, self._rng = SimTorqueState(), np.random.default_rng((seed, 1))
        self._noise_sd = np.array([force_noise_sd_n] * 3 + [0.0] + [torque.noise_sd_n_m] * 2)
        self._torque.open(0, self._state, self._rng)
        self.put_load(0.0)

    def put_load(self, load_n_m: float) -> None:
        """Put a torque on the sensor in addition to the phantom's; 0 takes it off."""
        self.load_n_m, self.felt_ns, self.felt_y_m = load_n_m, 0, 0.0

    def wrench(self, now_ns: int) -> list[float]:
        """Return a sample: forces in N and torques in N m about x, y, z."""
        if self.load_n_m and not self.felt_ns:
            self.felt_ns, self.felt_y_m = now_ns, self._axes.y.position_m(now_ns)
        lateral_n, normal_n, torque_n_m = self._contact.loads(now_ns)
        times_ns = np.array([max(now_ns, self._state.last_ns)])  # clients ask in any order
        true_n_m = np.array([torque_n_m + self.load_n_m])
        block = self._torque.read(true_n_m, times_ns, self._state, self._rng)
        wrench: list[float] = (self._rng.standard_normal(6) * self._noise_sd).tolist()
        wrench[1] += lateral_n
        wrench[2] += normal_n
        wrench[3] = float(block.torque_n_m[0])
        return wrench


class Netcanoem:
    """The sensor: identifiers and data in, identifiers and data out."""

    def __init__(
        self,
        wrench: Callable[[int], list[float]],
        bias: tuple[int, ...] = (37, -120, 64, 11, -85, 90),
        gauges: tuple[int, ...] | None = None,
    ) -> None:
        self._wrench, self._bias, self._fixed = wrench, bias, gauges
        self.status, self.saturated = 0, tuple[int, ...]()
        self.matrix: Float64Array = (NANO17_N_PER_V / _COUNTS_PER_VOLT * _COUNTS_PER_UNIT).astype(np.float32)
        per_count = NANO17_N_PER_V / _COUNTS_PER_VOLT
        per_count[3:] *= 1e-3
        self._gauges_of: list[list[float]] = np.linalg.inv(per_count).tolist()

    def answer(self, identifier: int, data: bytes, now_ns: int) -> list[tuple[int, bytes]]:
        """Return the frames that answer a frame; none if it is not for this sensor."""
        if identifier & 0x7F0 != _BASE:
            return []
        operation, argument = identifier & 0xF, data[0] if data else -1
        match operation, len(data):
            case 0x0, 0:
                return self._sample(now_ns)
            case 0x2, 1 if argument < 6:
                row = struct.pack(">6f", *self.matrix[argument])
                return [(_BASE + 2 + i, row[8 * i : 8 * i + 8]) for i in range(3)]
            case 0x5, 0:
                reply = b"FT32918 "
            case 0x6, 1 if argument < 16:
                reply = data
            case 0x7, 0:
                reply = struct.pack(">II", _COUNTS_PER_UNIT, _COUNTS_PER_UNIT)
            case 0x8, 0:
                reply = bytes([2, 4])
            case 0xF, 0:
                reply = bytes([3, 8, 0, 1])
            case _:
                return []
        return [(identifier, reply)]

    def _sample(self, now_ns: int) -> list[tuple[int, bytes]]:
        if self._fixed is not None:
            values = list(self._fixed)
        else:
            wrench = self._wrench(now_ns)
            values = [
                min(max(round(sum(map(mul, row, wrench))) + bias, -32768), 32767)
                for row, bias in zip(self._gauges_of, self._bias, strict=True)
            ]
        for gauge in self.saturated:
            values[gauge] = 32767
        first = struct.pack(">H3h", self.status, *values[0::2])
        return [(_BASE, first), (_BASE + 1, struct.pack(">3h", *values[1::2]))]


class SocketCand:
    """One client of the socketcand server; the sensor is the only other member of the bus."""

    def __init__(self, sensor: Netcanoem, bitrate: int) -> None:
        self._sensor, self._bitrate = sensor, bitrate
        self._rest = b""
        self.greeting, self.ready_ns = b"< hi >", 0

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Take commands in angle brackets."""
        reply = b""
        *commands, self._rest = (self._rest + data).split(b">")
        for text in commands:
            words = text.strip(b" <\r\n\x00").decode("ascii", "replace").split()
            if words[:1] == ["open"] or words == ["rawmode"]:
                reply += b"< ok >"
            elif words[:1] == ["send"] and len(words) >= 3:
                reply += self._send(words, now_ns)
        return reply

    def _send(self, words: list[str], now_ns: int) -> bytes:
        try:
            identifier, length = int(words[1], 16), int(words[2], 16)
            data = bytes(int(byte, 16) for byte in words[3 : 3 + length])
        except ValueError:
            return b"< error could not parse >"
        frames = self._sensor.answer(identifier, data, now_ns)
        if self._bitrate:
            bits = sum(_BITS.get(len(sent), 127) for sent in [data, *(answer for _, answer in frames)])
            self.ready_ns = max(self.ready_ns, now_ns) + bits * 1_000_000_000 // self._bitrate
        stamp = f"{now_ns * 1e-9:.6f}"
        return b"".join(
            f"< frame {number:03X} {stamp} {content.hex().upper()} >".encode("ascii")
            for number, content in frames
        )
