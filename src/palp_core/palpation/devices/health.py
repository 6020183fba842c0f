"""What state a device is in, by name, and since when."""

import threading
from dataclasses import dataclass
from enum import StrEnum


class Condition(StrEnum):
    """Named states of a device and its link; ``docs/reference/faults.md`` has the way out of each."""

    OK = "ok"
    CLOSED = "closed"
    STALE = "stale"
    LINK_LOST = "link lost"
    GARBLED = "garbled"
    SATURATED = "saturated"
    DEVICE_FAULT = "device fault"
    LIMIT = "limit"
    E_STOP = "e-stop"
    DISABLED = "disabled"
    STALLED = "stalled"


@dataclass(frozen=True)
class DeviceHealth:
    """A condition, the time at which it began and a text of its cause (empty if all is well)."""

    condition: Condition
    since_ns: int = 0
    cause: str = ""

    @property
    def ok(self) -> bool:
        """Whether the device does what it should."""
        return self.condition is Condition.OK


HEALTHY = DeviceHealth(Condition.OK)
"""What a simulated device always is."""


class HealthMonitor:
    """Keep a device's health; written by the driver's thread, read by the caller's.

    A condition that is reported stays until another is. ``stale`` is not reported but follows from silence:
    nothing fresh for longer than ``stale_s`` while all else is well.
    """

    def __init__(self, stale_s: float) -> None:
        self._stale_ns = round(stale_s * 1e9)
        self._lock = threading.Lock()
        self._health = DeviceHealth(Condition.CLOSED)
        self._fresh_ns = 0
        self._well = False

    def note_data(self, now_ns: int) -> None:
        """Note that good data arrived; ends every condition that ends by itself."""
        self._fresh_ns = now_ns
        if not self._well:
            self.report(Condition.OK, now_ns)

    def note_contact(self, now_ns: int) -> None:
        """Note that the device spoke, without a word on how it is."""
        self._fresh_ns = now_ns

    def report(self, condition: Condition, now_ns: int, cause: str = "") -> None:
        """Enter a condition; the same one again keeps its beginning."""
        with self._lock:
            if condition is not self._health.condition:
                self._health = DeviceHealth(condition, now_ns, cause)
                self._well = condition is Condition.OK

    def read(self, now_ns: int) -> DeviceHealth:
        """Return the present health."""
        health, silent_ns = self._health, now_ns - self._fresh_ns
        if health.ok and 0 < self._stale_ns < silent_ns:
            return DeviceHealth(Condition.STALE, self._fresh_ns, f"no data for {silent_ns * 1e-6:.1f} ms")
        return health
