"""How fast the drivers are beside the bare libraries, and how soon each fault has a name.

CAN: samples a second of the ATI driver as fast as the sensor answers, against ``python-can``'s send and two
receives. Serial: questions a second of the stage's link, against ``pyserial``'s write and ``read_until``.
Both on the same emulator, in a process of its own, without pacing, in interleaved rounds; a ratio is the
median over the rounds, above 1 where palp is faster. Polls at 1 kHz and 500 kbit/s: intervals over 3 ms are
gaps. Faults: from the command to the emulator to the named state, per device.

With ``--rig``: launch/rig.yaml on emulated devices of this process; from a gauge at its end to ABORT at the
controller, how far a sweep goes on, and how long after the death or stop of each node the stage rests. This
process is devices and observer at once: on a busy host the latencies are mostly its own.

Run: .venv/bin/python benchmarks/devices.py [--quick] [--json] [--rig]
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import can
import numpy as np
import serial
from rig_bench.trips import deaths, trips

from palp_core.devices import open_device
from palp_core.devices.aerotech import AerotechState
from palp_core.devices.aerotech_link import AerotechLink
from palp_core.devices.emg_source import EmgSourceState
from palp_core.devices.maestro import MaestroState
from palp_core.devices.wrench_state import WrenchState

RNG = np.random.default_rng(0)
STATES: dict[str, type[Any]] = {
    "stage": AerotechState,
    "ring": MaestroState,
    "torque": WrenchState,
    "emg": EmgSourceState,
}
KINDS = {
    "aerotech": "stage",
    "maestro": "ring",
    "ati": "torque",
    "netft": "torque",
    "noraxon": "emg",
    "spikershield": "emg",
}
FAULTS = {
    "aerotech": ["garbage", "truncation", "delay 0.6", "silence", "disconnect", "limit", "e-stop"],
    "maestro": ["garbage", "truncation", "delay 0.5", "silence", "disconnect", "checksum", "stalled"],
    "ati": ["truncation", "delay 0.1", "silence", "disconnect", "saturated", "status"],
    "netft": ["garbage", "truncation", "delay 0.2", "silence", "disconnect", "saturated", "status"],
    "noraxon": ["garbage", "truncation", "delay 2", "silence", "disconnect"],
    "spikershield": ["garbage", "truncation", "delay 0.5", "silence", "disconnect"],
}


class Emulator:
    """An emulated rig in a process of its own."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "palp_core.devices.emulator", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self.options: dict[str, dict[str, Any]] = json.loads(self._line())

    def tell(self, command: str) -> str:
        """Send a command and return its answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        return self._line()

    def close(self) -> None:
        """End the process."""
        self._process.communicate("quit\n", timeout=20)

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


@contextmanager
def emulator(*arguments: str) -> Iterator[Emulator]:
    """Run an emulated rig for a while."""
    rig = Emulator(*arguments)
    try:
        yield rig
    finally:
        rig.close()


def bare_can(options: dict[str, Any], seconds: float) -> float:
    """Return samples a second with python-can alone."""
    link = {"interface": options["interface"], "channel": options["channel"], **options["options"]}
    count = 0
    with can.Bus(**link) as bus:
        request = can.Message(arbitration_id=0x200, is_extended_id=False, data=b"")
        begin = time.perf_counter()
        while (took := time.perf_counter() - begin) < seconds:
            bus.send(request)
            if bus.recv(1.0) is not None and bus.recv(1.0) is not None:
                count += 1
    return count / took


def driven_can(options: dict[str, Any], seconds: float) -> float:
    """Return samples a second with the driver, drained as a node drains it."""
    sensor = open_device("torque", "ati", **options, rate_hz=0.0)
    state, pause, count = WrenchState(), threading.Event(), 0
    sensor.open(time.monotonic_ns(), state, RNG)
    begin = time.perf_counter()
    while (took := time.perf_counter() - begin) < seconds:
        pause.wait(0.02)
        count += len(sensor.drain(time.monotonic_ns(), state, RNG).times_ns)
    sensor.close()
    return count / took


def bare_serial(options: dict[str, Any], seconds: float) -> float:
    """Return questions a second with pyserial alone."""
    count = 0
    with serial.serial_for_url(options["url"], 115200, timeout=1.0) as port:
        begin = time.perf_counter()
        while (took := time.perf_counter() - begin) < seconds:
            port.write(b"PFBKPROG(X)\n")
            float(port.read_until(b"\n")[1:])
            count += 1
    return count / took


def driven_serial(options: dict[str, Any], seconds: float) -> float:
    """Return questions a second with the stage's link."""
    link, count = AerotechLink(options["url"], 115200, 1.0), 0
    begin = time.perf_counter()
    while (took := time.perf_counter() - begin) < seconds:
        link.number("PFBKPROG(X)")
        count += 1
    link.close()
    return count / took


def compare(
    name: str, bare: Callable[[float], float], driven: Callable[[float], float], rounds: int, seconds: float
) -> dict[str, float]:
    """Return both rates and their ratio, of interleaved rounds."""
    pairs = [(bare(seconds), driven(seconds)) for _ in range(rounds)]
    return {
        f"{name}_bare_per_s": statistics.median(b for b, _ in pairs),
        f"{name}_driver_per_s": statistics.median(d for _, d in pairs),
        f"{name}_ratio": statistics.median(d / b for b, d in pairs),
    }


def polled(options: dict[str, Any], seconds: float) -> dict[str, float]:
    """Return how evenly the sensor is polled at 1 kHz."""
    sensor = open_device("torque", "ati", **options)
    state, pause, stamps = WrenchState(), threading.Event(), []
    sensor.open(time.monotonic_ns(), state, RNG)
    begin = time.perf_counter()
    while time.perf_counter() - begin < seconds:
        pause.wait(0.002)
        stamps.append(sensor.drain(time.monotonic_ns(), state, RNG).times_ns)
    sensor.close()
    steps_ms = np.diff(np.concatenate(stamps)) * 1e-6
    return {
        "poll_hz": 1e3 / float(steps_ms.mean()),
        "poll_gap_rate": float(np.count_nonzero(np.greater(steps_ms, 3.0)) / steps_ms.size),
        "poll_jitter_ms": float(steps_ms.std()),
        "poll_step_p99_ms": float(np.quantile(steps_ms, 0.99)),
        "poll_step_max_ms": float(steps_ms.max()),
    }


def name_fault(rig: Emulator, device: str, fault: str) -> dict[str, object]:
    """Return the state that a fault led to and how soon, for a device that was moving or streaming."""
    kind = KINDS[device]
    driver: Any = open_device(kind, device, **rig.options[device])  # type: ignore[call-overload]
    state, pause = STATES[kind](), threading.Event()
    driver.open(time.monotonic_ns(), state, RNG)
    if kind == "stage":
        driver.return_to(-0.05, time.monotonic_ns(), state)
    elif kind == "ring":
        driver.command(0.01, time.monotonic_ns(), state, RNG)
    pause.wait(0.1)
    begin = time.monotonic()
    rig.tell(f"fault {device} {fault}")
    while driver.health(time.monotonic_ns()).ok and time.monotonic() - begin < 5.0:
        pause.wait(0.0005)
    took_s, health = time.monotonic() - begin, driver.health(time.monotonic_ns())
    driver.close()
    return {"state": str(health.condition), "within_s": round(took_s, 4)}


def faults() -> dict[str, dict[str, object]]:
    """Return what every fault of every device is named and how soon, each on an emulator of its own."""
    result = {}
    for device, names in FAULTS.items():
        for fault in names:
            with emulator("--devices", device) as rig:
                result[f"{device} {fault}"] = name_fault(rig, device, fault)
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="within 40 s, without the table of faults")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    parser.add_argument("--rig", action="store_true", help="only how soon the whole rig stops, 20 min")
    given = parser.parse_args()
    if given.rig:
        print(json.dumps({"trips": trips(1000, 20), "deaths_ms": deaths()}, indent=1))
        return
    rounds, seconds = (5, 0.8) if given.quick else (9, 3.0)
    result: dict[str, Any] = {}
    with emulator("--devices", "ati", "--can-bitrate", "0") as rig:
        link = rig.options["ati"]
        result |= compare("can", lambda s: bare_can(link, s), lambda s: driven_can(link, s), rounds, seconds)
    with emulator("--devices", "aerotech", "--stage-serial", "--stage-baud", "0") as rig:
        port = rig.options["aerotech"]
        result |= compare(
            "serial", lambda s: bare_serial(port, s), lambda s: driven_serial(port, s), rounds, seconds
        )
    with emulator("--devices", "ati") as rig:
        result |= polled(rig.options["ati"], 5.0 if given.quick else 60.0)
    if not given.quick:
        result["faults"] = faults()
    if given.json:
        print(json.dumps(result))
        return
    for key, value in result.items():
        if isinstance(value, dict):
            for name, row in value.items():
                print(f"{name:28} {row['state']:14} {row['within_s'] * 1e3:8.1f} ms")
        else:
            print(f"{key:24} {value:.4g}")


if __name__ == "__main__":
    main()
