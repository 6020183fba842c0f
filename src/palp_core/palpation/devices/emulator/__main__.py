"""An emulated rig as a process: ``python -m palp_core.palpation.devices.emulator [--devices a,b]``.

It prints one line of JSON, the drivers' options by device, and then obeys lines on its standard input until
that ends: ``fault DEVICE NAME [VALUE [COUNT]]``, ``clear DEVICE``, ``disconnect DEVICE``, ``connect DEVICE``,
``mount CODE [HEIGHT_OFFSET_MM]``, ``load N_MM`` (an extra torque), ``truth``, ``axes`` (of the stage),
``log SINCE_NS`` (what its controller was sent, and when), ``stop-link`` (its second TCP port), ``quit``. Each
is answered with a line: ``ok``, JSON, or ``error: ...``.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any, TextIO

import msgspec

from palp_core.errors import PalpError
from palp_core.palpation.devices.emulator.contact import ContactSettings
from palp_core.palpation.devices.emulator.rig import DEVICES, EmulatedRig
from palp_core.palpation.devices.emulator.settings import RigSettings


def serve(rig: EmulatedRig, lines: Iterable[str], out: TextIO) -> None:
    """Obey commands until there are no more, or ``quit``."""
    for line in lines:
        words = line.split()
        if words == ["quit"]:
            return
        if not words:
            continue
        try:
            answer = _obey(rig, words)
        except (PalpError, ValueError, IndexError, KeyError) as error:
            answer = f"error: {error}"
        out.write(answer + "\n")
        out.flush()


def main(arguments: list[str] | None = None) -> None:
    """Run an emulated rig until standard input ends."""
    sys.setswitchinterval(0.0005)  # the solver's thread must not hold up the wires
    parser = argparse.ArgumentParser(
        prog="python -m palp_core.palpation.devices.emulator", description=__doc__
    )
    parser.add_argument("--devices", default=",".join(DEVICES[:4]), help="comma-separated")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--phantoms", default="", help="YAML file of phantoms by code")
    parser.add_argument("--stage-serial", action="store_true", help="the stage on a terminal, not on TCP")
    parser.add_argument("--stage-baud", type=int, default=RigSettings().stage_baud, help="0: not paced")
    parser.add_argument("--can-bitrate", type=int, default=RigSettings().can_bitrate, help="0: not paced")
    parser.add_argument("--settings", default="", help="all of RigSettings as JSON, instead of the others")
    parser.add_argument("--priority", type=int, default=0, help="real-time priority, where it is allowed")
    given = parser.parse_args(arguments)
    settings = replace(
        RigSettings(),
        seed=given.seed,
        contact=ContactSettings(phantoms=given.phantoms),
        stage_serial=given.stage_serial,
        stage_baud=given.stage_baud,
        can_bitrate=given.can_bitrate,
    )
    if given.settings:
        settings = msgspec.json.decode(given.settings, type=RigSettings)
    if given.priority:
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(given.priority))
    with EmulatedRig(settings, [name for name in given.devices.split(",") if name]) as rig:
        sys.stdout.write(json.dumps(rig.options) + "\n")
        sys.stdout.flush()
        serve(rig, sys.stdin, sys.stdout)


def _obey(rig: EmulatedRig, words: list[str]) -> str:
    match words:
        case ["fault", device, name]:
            rig.fault(device, name)
        case ["fault", device, name, value]:
            rig.fault(device, name, value=float(value))
        case ["fault", device, name, value, count]:
            rig.fault(device, name, int(count), float(value))
        case ["clear", device]:
            rig.clear(device)
        case ["disconnect", device]:
            rig.disconnect(device)
        case ["connect", device]:
            rig.connect(device)
        case ["mount", code]:
            rig.call(lambda _: rig.contact.mount(code, 0.0))
        case ["mount", code, height_mm]:
            offset_m = float(height_mm) * 1e-3
            rig.call(lambda _: rig.contact.mount(code, offset_m))
        case ["load", n_mm]:
            rig.call(lambda _: rig.sensor.put_load(float(n_mm) * 1e-3))
        case ["axes"]:
            return json.dumps(rig.call(lambda now_ns: _axes(rig, now_ns)))
        case ["log", since_ns]:
            return json.dumps(rig.call(lambda _: [e for e in rig.axes.log if e[0] >= int(since_ns)]))
        case ["stop-link"]:
            return json.dumps(rig.stop_link)
        case ["truth"]:
            return json.dumps(rig.call(rig.truth))
        case _:
            raise ValueError(f"'{' '.join(words)}' is no command; see --help")
    return "ok"


def _axes(rig: EmulatedRig, now_ns: int) -> dict[str, Any]:
    """Return how the stage's axes are, in truth."""
    axes = {
        name: {
            "position_m": axis.position_m(now_ns),
            "velocity_m_per_s": axis.velocity_m_per_s(now_ns),
            "moving": axis.moving(now_ns),
            "enabled": axis.enabled,
            "rest_ns": axis.rest_ns,
        }
        for name, axis in (("y", rig.axes.y), ("z", rig.axes.z))
    }
    return {"now_ns": now_ns, "felt_ns": rig.sensor.felt_ns, "felt_y_m": rig.sensor.felt_y_m, **axes}


if __name__ == "__main__":
    main()
