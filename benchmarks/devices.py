"""How fast the drivers are compared with the bare libraries, and how soon each fault has a name.

CAN: samples a second of the ATI driver as fast as the sensor answers, against ``python-can``'s send and two
receives. Serial: questions a second of the stage's link, against ``pyserial``'s write and ``read_until``.
Both on the same emulator, in a process of its own, without pacing, in interleaved rounds; a ratio is the
median over the rounds, above 1 where palp is faster. ``faults``: from the command to the emulator to the
named state, per device, and whether in time.

Of the whole rig, its nodes on devices that are emulated in a process of their own:

``trips``: from the sensor's first sample over the limit to ABORT at the controller, as the kernel stamped its
arrival, and how far a sweep goes on. ``deaths``: how long after kill -9 and SIGSTOP of each node and the
launcher the stage rests. ``palpations``: launch/emulated.yaml from the sensor to the belief, and its sweeps
against those of the simulation. ``decisions``: trials decided within the sweep: how soon, how far the stage
goes on, and trips.

Run: .venv/bin/python benchmarks/devices.py [links|faults|trips|deaths|palpations|decisions] [--json]
     [--quick] [--of NODE,NODE] [--single-line] [--stale-ms MS] [--beat-ms MS]
"""

from __future__ import annotations

import argparse
import json
import statistics
import threading
import time
from collections.abc import Callable
from typing import Any

import can
import numpy as np
import serial
from rig_bench.emulator import EmulatorProcess, emulator, host_words
from rig_bench.faults import FAULTS, KINDS, Fault
from rig_bench.palpations import decisions, palpations
from rig_bench.trips import NODES, deaths, trips

from palp_core.palpation.devices import open_device
from palp_core.palpation.devices.emg.emg_source import EmgSourceState
from palp_core.palpation.devices.emulator import RigSettings
from palp_core.palpation.devices.ring.maestro import MaestroState
from palp_core.palpation.devices.stage.aerotech import AerotechState
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.torque.ati import AtiState

RNG = np.random.default_rng(0)
STATES: dict[str, type[Any]] = {
    "stage": AerotechState,
    "ring": MaestroState,
    "torque": AtiState,
    "emg": EmgSourceState,
}


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
    state, pause, count = AtiState(), threading.Event(), 0
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
    bare(seconds)  # the first request to an emulator may find it not ready
    pairs = [(bare(seconds), driven(seconds)) for _ in range(rounds)]
    return {
        f"{name}_bare_per_s": statistics.median(b for b, _ in pairs),
        f"{name}_driver_per_s": statistics.median(d for _, d in pairs),
        f"{name}_ratio": statistics.median(d / b for b, d in pairs),
    }


def name_fault(rig: EmulatorProcess, fault: Fault) -> dict[str, object]:
    """Return the state that a fault led to and how soon, for a device that was moving or streaming."""
    device, kind = fault.device, KINDS[fault.device]
    driver: Any = open_device(kind, device, **rig.options[device])
    state, pause = STATES[kind](), threading.Event()
    driver.open(time.monotonic_ns(), state, RNG)
    if kind == "stage":
        driver.return_to(-0.05, time.monotonic_ns(), state)
    elif kind == "ring":
        driver.command(0.01, time.monotonic_ns(), state, RNG)
    pause.wait(0.1)
    begin = time.monotonic()
    value = (
        f" {fault.value or 0.1} {fault.count}" if fault.count else f" {fault.value}" if fault.value else ""
    )
    rig.send(f"fault {device} {fault.name}{value}")
    while driver.health(time.monotonic_ns()).ok and time.monotonic() - begin < 5.0:
        pause.wait(0.0005)
    took_s, health = time.monotonic() - begin, driver.health(time.monotonic_ns())
    driver.close()
    return {
        "state": str(health.condition),
        "after_s": round(took_s, 4),
        "in_time": str(health.condition) in fault.states and took_s * 1e3 <= fault.within_ms,
    }


def faults() -> dict[str, dict[str, object]]:
    """Return what every fault of every device is named and how soon, each on an emulator of its own."""
    result = {}
    for fault in FAULTS:
        with emulator(fault.device) as rig:
            result[f"{fault.device} {fault.name}"] = name_fault(rig, fault)
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "what",
        nargs="?",
        default="links",
        choices=["links", "faults", "trips", "deaths", "palpations", "decisions"],
    )
    parser.add_argument("--quick", action="store_true", help="of links: within 40 s")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    parser.add_argument(
        "--count",
        type=int,
        default=0,
        help="trips (1000), repeats of a death (3), palpations (10), decisions (201)",
    )
    parser.add_argument("--of", default=",".join(NODES), help="of deaths: whose; A+B: of both at once")
    parser.add_argument("--single-line", action="store_true", help="of deaths: the stage on one RS-232")
    parser.add_argument("--stale-ms", type=float, default=0.0, help="of decisions: not the launch file's")
    parser.add_argument("--beat-ms", type=float, default=0.0, help="of decisions: not the launch file's")
    given = parser.parse_args()
    host, count = host_words(), given.count
    if given.what == "trips":
        swept = min(20, count or 20)
        result = trips((count or 1000) - swept, swept)
    elif given.what == "deaths":
        result = deaths(tuple(given.of.split(",")), count or 3, single_line=given.single_line)
    elif given.what == "palpations":
        result = palpations(count or 10)
    elif given.what == "decisions":
        result = decisions(count or 201, stale_ms=given.stale_ms, beat_ms=given.beat_ms)
    elif given.what == "faults":
        result = faults()
    else:
        result = links(given.quick)
    result = {"host": host} | result
    print(json.dumps(result, indent=None if given.what == "links" else 1) if given.json else in_lines(result))


def links(quick: bool) -> dict[str, Any]:
    """Return how fast the drivers are compared with the bare libraries."""
    rounds, seconds = (5, 0.8) if quick else (9, 3.0)
    result: dict[str, Any] = {}
    with emulator("ati", settings=RigSettings(can_bitrate=0)) as rig:
        link = rig.options["ati"]
        result |= compare("can", lambda s: bare_can(link, s), lambda s: driven_can(link, s), rounds, seconds)
    with emulator("aerotech", settings=RigSettings(stage_serial=True, stage_baud=0)) as rig:
        port = rig.options["aerotech"]
        result |= compare(
            "serial", lambda s: bare_serial(port, s), lambda s: driven_serial(port, s), rounds, seconds
        )
    return result


def in_lines(result: dict[str, Any]) -> str:
    """Return a line per number, and per row of a table."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            lines += [f"{key} {name:28} {json.dumps(row)}" for name, row in value.items()]
        else:
            lines.append(f"{key:24} {value:.4g}" if isinstance(value, float) else f"{key:24} {value}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
