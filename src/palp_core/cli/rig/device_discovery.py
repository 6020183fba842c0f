"""Which devices have a driver; is one there, and what does it deliver?"""

from __future__ import annotations

import inspect
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from threading import Event
from typing import Any

import numpy as np

from palp_core.errors import DeviceError, in_words
from palp_core.foreign import catch_foreign
from palp_core.palpation.devices.contract import Subject
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.protocols import EmgSamples, Mover, TorqueSamples
from palp_core.palpation.devices.registry import back_end, drivers, kind_of, open_device
from palp_core.palpation.devices.torque.ati import AtiTorque
from palp_core.palpation.devices.unverified import UnverifiedWarning, not_verified
from palp_core.published import DEVICES, published

LISTEN_S = 0.5


@dataclass(frozen=True)
class DeviceEntry:
    """A device: kind, name, link, and the options of its driver with their defaults as text."""

    kind: str
    name: str
    link: str
    options: dict[str, str]


def device_entries(names: Sequence[str] = ()) -> list[DeviceEntry]:
    """Return every device that has a driver, by kind and name, or those named."""
    return [_entry(kind_of(name), name) for name in names] or [
        _entry(kind, name, lenient=not published(DEVICES)[f"{kind}.{name}"].startswith("palp_core."))
        for kind, name in drivers()
    ]


def _entry(kind: str, name: str, *, lenient: bool = False) -> DeviceEntry:
    """Return a device; of one whose own package cannot be imported the error is in place of its link."""
    try:
        driver = back_end(kind, name)
    except DeviceError as error:
        if not lenient:
            raise
        return DeviceEntry(kind, name, str(error), {})
    defaults = {p.name: p.default for p in inspect.signature(driver).parameters.values()}
    options = {
        n: "" if default is inspect.Parameter.empty else str(default) for n, default in defaults.items()
    }
    return DeviceEntry(kind, name, getattr(driver, "LINK", "its own"), options)


def discover(device: str, options: Mapping[str, Any], patience_s: float) -> dict[str, Any]:
    """Ask a device whether it is there and how it does; nothing moves and nothing is enabled."""
    kind = kind_of(device)
    if kind in ("stage", "ring"):
        return _discover_mover(kind, device, options)
    stretches = watch(device, options, max(patience_s, LISTEN_S), LISTEN_S, patience_s)
    row = next((one for one in stretches if one["samples"]), None)  # a busy host may leave one without any
    if row is None:
        raise DeviceError(f"{device}: it is connected but sends nothing; is it measuring?")
    if row["state"] in (Condition.GARBLED, Condition.LINK_LOST):
        raise DeviceError(f"{device}: {row['state']}: garbled answers; check the port and the baud rate")
    if row["state"] == Condition.STALE:
        raise DeviceError(f"{device}: it fell silent while it was listened to; check cable and supply")
    return row


def unverified(device: str, options: Mapping[str, Any]) -> dict[str, str]:
    """Return which parameters were not checked on the device, and what is to be checked of each."""
    driver: Any = open_device(kind_of(device), device, **options)  # type: ignore[call-overload]
    return not_verified(device, getattr(driver, "UNVERIFIED", {}), getattr(driver, "verified", ()))


def why_broken(check: Callable[[Subject], None], subject: Subject) -> str:
    """Return why a device breaks a promise; "" if it keeps it."""
    try:
        with subject:
            check(subject)
    except AssertionError as broken:
        return str(broken)
    except DeviceError as error:
        return f"it refuses: {in_words(error)}"
    except Exception as error:  # noqa: BLE001 - a driver may raise anything, and the next promise is checked
        place = inspect.getinnerframes(error.__traceback__)[-1] if error.__traceback__ else None
        return f"it fails: {in_words(error)}" + (f" ({place.filename}:{place.lineno})" if place else "")
    return ""


def watch(
    device: str, options: Mapping[str, Any], seconds: float, every_s: float, patience_s: float
) -> Iterator[dict[str, Any]]:
    """Yield what a sensor delivered in each stretch of time."""
    kind = kind_of(device)
    if kind in ("stage", "ring"):
        raise DeviceError(f"{device} moves and delivers no stream; try: palp devices probe {device}")
    check_range(device, "seconds", seconds, 0.0, 1e9)
    check_range(device, "every_s", every_s, 1e-3, 1e6)
    check_range(device, "patience_s", patience_s, 0.0, 1e6)
    sensor: Any = open_device("torque" if kind == "torque" else "emg", device, **options)
    state: Any = sensor.state_type()
    rng, pause = np.random.default_rng(0), Event()
    with catch_foreign(f"{device}: cannot open it", DeviceError), warnings.catch_warnings():
        warnings.simplefilter("ignore", UnverifiedWarning)  # it is asked for: unverified()
        sensor.open(time.monotonic_ns(), state, rng)
    try:
        _await_first(device, sensor, pause, patience_s)
        begin_ns = time.monotonic_ns()
        sensor.drain(begin_ns, state, rng)  # what had waited is of before
        end_ns = begin_ns + round(seconds * 1e9) if seconds else 0
        while not end_ns or time.monotonic_ns() < end_ns:
            pause.wait(every_s)
            now_ns = time.monotonic_ns()
            block = sensor.drain(now_ns, state, rng)
            row = _row(block, str(sensor.health(now_ns).condition), (now_ns - begin_ns) / 1e9, sensor.rate_hz)
            begin_ns = now_ns
            if isinstance(sensor, AtiTorque):
                row["serial_number"] = sensor.sensor.serial_number
                row["firmware"] = ".".join(map(str, sensor.sensor.firmware))
            yield row
    finally:
        sensor.close()


def _await_first(device: str, sensor: Any, pause: Event, patience_s: float) -> None:
    until_ns = time.monotonic_ns() + round(patience_s * 1e9)
    while not (health := sensor.health(time.monotonic_ns())).ok:
        if time.monotonic_ns() > until_ns:
            raise DeviceError(
                f"{device}: no data within {patience_s:g} s: {health.condition}: {health.cause};"
                " check that it measures, and its rate and baud rate"
            )
        pause.wait(0.01)


def _row(
    block: TorqueSamples | EmgSamples, condition: str, span_s: float, nominal_hz: float
) -> dict[str, Any]:
    count = len(block.times_ns)
    row: dict[str, Any] = {
        "state": condition,
        "samples": count,
        "rate_hz": count / span_s,
        "nominal_hz": nominal_hz,
        "gaps": int(np.count_nonzero(block.gap)),
        "drift_ppm": block.clock.drift * 1e6,
        "jitter_us": block.clock.residual_s * 1e6,
    }
    if isinstance(block, TorqueSamples):
        names = ("fx_n", "fy_n", "fz_n", "tx_n_m", "ty_n_m", "tz_n_m")
        if count and not len(block.wrench):  # a sensor of one axis has no forces
            columns = {"torque_n_m": block.torque_n_m}
        else:
            columns = dict(zip(names, block.wrench.T, strict=True))
        row["faulty"] = int(np.count_nonzero(block.faulty))
    else:
        columns = {"fds_v": block.fds_v, "edc_v": block.edc_v}
    for name, values in columns.items():
        row[name] = float(np.mean(values)) if count else 0.0
        row[f"{name}_sd"] = float(np.std(values)) if count else 0.0
    return row


def _discover_mover(kind: str, device: str, options: Mapping[str, Any]) -> dict[str, Any]:
    driver = back_end(kind, device)
    needed = {p.name for p in inspect.signature(driver).parameters.values() if p.default is p.empty}
    if needed - set(options):
        raise DeviceError(f"{device}: where is it? give {driver.ADDRESS}")
    mover: Mover[Any] = open_device(kind, device, **options)  # type: ignore[call-overload]
    with catch_foreign(f"{device}: cannot open it", DeviceError):
        return mover.discover()
