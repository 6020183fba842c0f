"""Simulated devices."""

from typing import Any, ClassVar

from palp_core.palpation.devices.health import HEALTHY, DeviceHealth


class Simulated:
    """A device without a link: it is always well, and nothing trips it."""

    LINK: ClassVar[str] = "none: simulated"
    ADDRESS: ClassVar[str] = ""

    def close(self) -> None:
        """Do nothing: there is no link."""

    def health(self, now_ns: int) -> DeviceHealth:
        """Return that all is well."""
        return HEALTHY

    def discover(self) -> dict[str, str]:
        """Return nothing: there is no link."""
        return {}

    def acknowledge(self, now_ns: int, state: Any) -> None:
        """Do nothing: nothing trips it."""
