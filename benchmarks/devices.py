"""How soon each fault of a device has a name, how soon the rig stops, and how soon it decides.

``faults``: from the command to the emulator to the named state, per device, and whether in time. The others
are of the whole rig, its nodes on devices that are emulated in a process of their own:

``trips``: from the sensor's first sample over the limit to ABORT at the controller, as the kernel stamped its
arrival, and how far a sweep goes on. ``deaths``: how long after kill -9 and SIGSTOP of each node and the
launcher the stage rests. ``decisions``: launch/emulated.yaml, trials decided within the sweep: how soon, how
far the stage goes on, and trips.

Run: .venv/bin/python benchmarks/devices.py faults|trips|deaths|decisions [--count N] [--of NODE,NODE]
     [--stale-ms MS] [--beat-ms MS]
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rig_bench.decisions import decisions
from rig_bench.emulator import EmulatorProcess, emulator, host_words
from rig_bench.faults import FAULTS, KINDS, Fault
from rig_bench.trips import NODES, deaths, trips

from palp_core.palpation.devices import open_device
from palp_core.palpation.devices.emg.emg_source import EmgSourceState
from palp_core.palpation.devices.ring.maestro import MaestroState
from palp_core.palpation.devices.stage.aerotech import AerotechState
from palp_core.palpation.devices.torque.ati import AtiState

RNG = np.random.default_rng(0)
STATES: dict[str, type[Any]] = {
    "stage": AerotechState,
    "ring": MaestroState,
    "torque": AtiState,
    "emg": EmgSourceState,
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
    result: dict[str, dict[str, object]] = {}
    for fault in FAULTS:
        with emulator(fault.device) as rig:
            result[f"{fault.device} {fault.name}"] = name_fault(rig, fault)
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["faults", "trips", "deaths", "decisions"])
    parser.add_argument(
        "--count", type=int, default=0, help="trips (1000), repeats of a death (3), decisions (201)"
    )
    parser.add_argument("--of", default=",".join(NODES), help="of deaths: whose; A+B: of both at once")
    parser.add_argument("--stale-ms", type=float, default=0.0, help="of decisions: not the launch file's")
    parser.add_argument("--beat-ms", type=float, default=0.0, help="of decisions: not the launch file's")
    given = parser.parse_args()
    count = given.count
    print(in_lines({"host": host_words()}))
    if given.what == "trips":
        swept = min(20, count or 20)
        result = trips((count or 1000) - swept, swept)
    elif given.what == "deaths":
        result = deaths(tuple(given.of.split(",")), count or 3)
    elif given.what == "decisions":
        result = decisions(count or 201, stale_ms=given.stale_ms, beat_ms=given.beat_ms)
    else:
        result = faults()
    print(in_lines(result))


def in_lines(result: Mapping[str, Any]) -> str:
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
