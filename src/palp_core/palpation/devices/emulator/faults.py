"""Faults of a wire, on command."""

from dataclasses import dataclass, field

import numpy as np

from palp_core.errors import DeviceError

WIRE_FAULTS = ("garbage", "truncation", "delay", "silence")
CHECKED_FAULTS = ("checksum",)


@dataclass
class Faults:
    """What is wrong with a wire at present, and for how many more replies.

    ``garbage`` replaces each byte by a random one, ``truncation`` cuts the second half, ``delay`` holds back
    by ``delay_s``, ``silence`` sends nothing, ``checksum`` flips a bit of what the host sends.

    Attributes:
        left: Number of replies each active fault is still good for; a large one for ever.
        delay_s: How long ``delay`` holds back.
    """

    seed: int = 0
    left: dict[str, int] = field(default_factory=dict)
    delay_s: float = 0.1

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def inject(self, name: str, count: int, delay_s: float) -> None:
        """Start a fault for ``count`` replies."""
        known = WIRE_FAULTS + CHECKED_FAULTS
        if name not in known:
            raise DeviceError(f"emulator: no fault '{name}'; a wire knows {', '.join(known)}")
        self.left[name] = count
        self.delay_s = delay_s

    def clear(self) -> None:
        """Make the wire good again."""
        self.left.clear()

    def spoil_request(self, data: bytes) -> bytes:
        """Return what arrives of what the host sent."""
        if data and self._use_up("checksum"):
            return data[:-1] + bytes([data[-1] ^ 0x01])
        return data

    def spoil_reply(self, data: bytes) -> tuple[bytes, int]:
        """Return what is left of a reply and by how many ns it is held back."""
        if not data or not self.left:
            return data, 0
        delay_ns = round(self.delay_s * 1e9) if self._use_up("delay") else 0
        if self._use_up("silence"):
            return b"", delay_ns
        if self._use_up("truncation"):
            data = data[: len(data) // 2]
        if self._use_up("garbage"):
            data = self._rng.bytes(len(data))
        return data, delay_ns

    def _use_up(self, name: str) -> bool:
        left = self.left.get(name, 0)
        if left <= 0:
            return False
        self.left[name] = left - 1
        return True
