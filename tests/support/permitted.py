"""A bench of a node that moves by permission, and a safety node that speaks as the test says."""

from __future__ import annotations

from typing import Any

from msgs.safety import SafetyBeat
from palp_core import Bench
from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import HEALTHY, Condition, DeviceHealth

PERMITTED = ("ready", "moving")
"""States of the safety node in which anything may move."""


class ScriptedDevice:
    """A device that is as a test says; ``calls`` is what was asked of it."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.condition = Condition.OK
        self.broken = False

    def close(self) -> None:
        self.calls.append("close")

    def health(self, now_ns: int) -> DeviceHealth:
        return HEALTHY if self.condition is Condition.OK else DeviceHealth(self.condition, 0, "scripted")

    def note(self, call: str, trouble: str) -> None:
        """Note a call; one to a device that is broken fails."""
        self.calls.append(call)
        if self.broken:
            raise DeviceError(trouble)


class PermittedBench:
    """A node that moves a device while it is permitted."""

    def __init__(self, bench: Bench[Any], device: Any) -> None:
        self.bench, self.device, self.link_seen = bench, device, True

    def beat(self, state: str = "ready", count: int = 0) -> None:
        """Let the safety node say how it is, and how many trips were acknowledged."""
        permits = state in PERMITTED
        self.bench.feed(
            type(self.bench.node).safety,
            SafetyBeat(
                stamp_ns=self.bench.clock.now_ns(),
                state=state,
                permits=permits,
                permits_sweep=permits and self.link_seen,
                acknowledged_count=count,
            ),
        )

    def run(self, seconds: float, state: str = "ready", count: int = 0) -> None:
        """Let time go by while the safety node says the same."""
        for _ in range(round(seconds * 100)):
            self.bench.advance(0.01)
            self.beat(state, count)

    @property
    def report(self) -> Any:
        """What the node reported of its device last."""
        return self.bench.sent(type(self.bench.node).report)[-1]
