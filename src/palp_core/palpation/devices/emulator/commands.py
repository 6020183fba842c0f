"""The lines that emulated devices obey, as ``palp devices emulate`` reads them.

``fault DEVICE NAME [VALUE [COUNT]]``, ``clear DEVICE``, ``disconnect DEVICE``, ``connect DEVICE``,
``mount CODE [HEIGHT_OFFSET_MM]``, ``load N_MM`` (an extra torque), ``truth``, ``axes`` (of the stage),
``log SINCE_NS`` (what its controller was sent, and when), ``stop-link`` (its second TCP port), ``quit``. Each
is answered with a line: ``ok``, JSON, or ``error: ...``.
"""

import json
from collections.abc import Iterable
from typing import Any, TextIO

import msgspec

from palp_core.errors import DeviceError, PalpError, in_words
from palp_core.palpation.devices.emulator.rig import EmulatedRig, RigSettings


def read_settings(text: str) -> RigSettings:
    """Return the settings of an emulated rig from JSON."""
    try:
        return msgspec.json.decode(text, type=RigSettings)
    except msgspec.MsgspecError as error:
        raise DeviceError(
            f"emulator: settings: {in_words(error)}; give the fields of RigSettings as JSON"
        ) from error


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
            raise ValueError(f"'{' '.join(words)}' is not a command; see palp devices emulate --help")
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
