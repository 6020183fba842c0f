"""Homing on an Aerotech controller: the only motion whose end the controller alone decides."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.wire import aerotech as wire


def home(link: AerotechLink, axes: Sequence[str], host: HostTime, timeout_s: float, period_s: float) -> None:
    """Home one axis after another; whatever ends it early also stops it, as nobody would watch it then.

    Args:
        link: Open link.
        axes: The controller's names, in this order.
        host: Time.
        timeout_s: Longest for an axis.
        period_s: Time between two looks.

    Raises:
        DeviceError: It takes too long, somebody stops it, or an answer is missing.
    """
    try:
        for axis in axes:
            _home(link, axis, host, timeout_s, period_s)
    except BaseException:
        with suppress(DeviceError):
            link.shout(b"".join(wire.command(f"ABORT {axis}") for axis in axes))
        raise


def _home(link: AerotechLink, axis: str, host: HostTime, timeout_s: float, period_s: float) -> None:
    link.do(wire.command(f"HOMEASYNC {axis}"))
    pause, until_ns = threading.Event(), host.now_ns() + round(timeout_s * 1e9)
    while True:
        status = link.bits(f"AXISSTATUS({axis})")
        if status & wire.Status.HOMED and not status & (wire.Status.HOMING | wire.Status.MOVING):
            return
        if not status & wire.Status.ENABLED:
            raise DeviceError(f"stage: axis {axis} was disabled while it homed")
        if host.now_ns() > until_ns:
            raise DeviceTimeout(f"stage: axis {axis} did not home within {timeout_s:g} s")
        pause.wait(period_s)
