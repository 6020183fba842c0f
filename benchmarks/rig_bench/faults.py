"""Every fault of every device: what it is named, within what time, and what leads out of it.

The tests of drivers and nodes run over these rows, the benchmark measures them, and the table in
``docs/reference/faults.md`` is made of them: ``python -m benchmarks.rig_bench.faults`` prints it.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ACKNOWLEDGE", "FAULTS", "ITSELF", "KINDS", "REOPEN", "Fault", "table"]

KINDS = {
    "aerotech": "stage",
    "maestro": "ring",
    "ati": "torque",
    "noraxon": "emg",
    "lsl": "emg",
}
STALE, LOST, GARBLED, FAULTY, STOPPED = "stale", "link lost", "garbled", "device fault", "disabled"
ITSELF, REOPEN, ACKNOWLEDGE = "itself", "reopen", "acknowledge"


@dataclass(frozen=True)
class Fault:
    """A fault of a device.

    Attributes:
        device: Name of the device.
        name: The emulator's name of the fault.
        words: What it is, for a person.
        states: Names that the driver gives it; the first comes first or is alone.
        within_ms: Longest time from the fault to the first name, on a host that is not overloaded: the
            driver's time-out, a poll or two, and a margin.
        way_out: What ends it once its cause is gone.
        trip: Cause of the trip in the rig's graph; empty for EMG, which stops nothing.
        count: For how many replies it lasts; 0 until it is cleared.
        value: Seconds of a delay.
    """

    device: str
    name: str
    words: str
    states: tuple[str, ...]
    within_ms: int
    way_out: str
    trip: str = ""
    count: int = 0
    value: float = 0.0


def _delay(seconds: float) -> str:
    return f"answers {seconds:g} s late"


_LINK, _AXIS, _RING, _SENSOR = "lost link", "axis fault", "ring fault", "sensor fault"

FAULTS = [
    Fault("aerotech", "garbage", "garbage", (STALE, GARBLED), 600, ITSELF, _LINK),
    Fault("aerotech", "truncation", "truncated answers", (STALE,), 400, ITSELF, _LINK),
    Fault("aerotech", "delay", _delay(0.6), (STALE,), 400, ITSELF, _LINK, value=0.6),
    Fault("aerotech", "silence", "silence", (STALE,), 400, ITSELF, _LINK),
    Fault("aerotech", "disconnect", "disconnect and return", (LOST,), 50, REOPEN, _LINK),
    Fault("aerotech", "limit", "limit switch hit", ("limit",), 50, ACKNOWLEDGE, _AXIS),
    Fault("aerotech", "e-stop", "emergency stop", ("e-stop",), 50, ACKNOWLEDGE, _AXIS),
    Fault("aerotech", "stuck", "axis stuck (position error)", (FAULTY,), 50, ACKNOWLEDGE, _AXIS),
    Fault("aerotech", "dropped", "probe drops on the way", (FAULTY,), 1500, ACKNOWLEDGE, _AXIS),
    Fault("aerotech", "short", "height not reached", (STOPPED,), 3500, ACKNOWLEDGE, _AXIS),
    Fault("maestro", "garbage", "garbage", (GARBLED, STALE), 400, ITSELF, _LINK),
    Fault("maestro", "truncation", "truncated answers", (STALE,), 400, ITSELF, _LINK),
    Fault("maestro", "delay", _delay(0.5), (STALE,), 400, ITSELF, _LINK, value=0.5),
    Fault("maestro", "silence", "silence", (STALE,), 400, ITSELF, _LINK),
    Fault("maestro", "disconnect", "disconnect and return", (LOST,), 100, REOPEN, _LINK),
    Fault("maestro", "checksum", "wrong check byte, once", (FAULTY,), 500, ACKNOWLEDGE, _RING, count=1),
    Fault("maestro", "stalled", "actuator stalled", ("stalled",), 1200, ACKNOWLEDGE, _RING),
    Fault("ati", "garbage", "garbage on the bus server", (LOST, STALE), 50, ITSELF, STALE, count=1),
    Fault("ati", "truncation", "truncated answers", (STALE, LOST), 50, ITSELF, STALE),
    Fault("ati", "delay", _delay(0.1), (STALE, LOST), 50, ITSELF, STALE, value=0.1),
    Fault("ati", "silence", "silence", (STALE, LOST), 50, ITSELF, STALE),
    Fault("ati", "disconnect", "disconnect and return", (LOST,), 50, ITSELF, STALE),
    Fault("ati", "saturated", "gauge saturated", ("saturated",), 25, ITSELF, "saturated"),
    Fault("ati", "status", "status bits", (FAULTY,), 25, ITSELF, _SENSOR),
    Fault("noraxon", "garbage", "garbage", (LOST,), 100, ITSELF, count=1),
    Fault("noraxon", "truncation", "truncated answers", (STALE, LOST), 400, ITSELF, count=1),
    Fault("noraxon", "delay", _delay(2.0), (STALE, LOST), 400, ITSELF, value=2.0),
    Fault("noraxon", "silence", "silence", (STALE, LOST), 400, ITSELF),
    Fault("noraxon", "disconnect", "disconnect and return", (LOST,), 100, ITSELF),
    Fault("lsl", "garbage", "garbage (values that are no numbers)", (GARBLED,), 400, ITSELF),
    Fault("lsl", "silence", "silence", (STALE,), 400, ITSELF),
    Fault("lsl", "disconnect", "stream withdrawn and offered again", (STALE, LOST), 400, ITSELF),
]


def table() -> str:
    """Return the table of the documentation."""
    lines = [
        "| device | fault | state | within, ms | way out | trip of the rig |",
        "|---|---|---|---|---|---|",
    ]
    for f in FAULTS:
        cells = (f.device, f.words, " or ".join(f.states), str(f.within_ms), f.way_out, f.trip or "-")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
