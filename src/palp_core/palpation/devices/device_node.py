"""What a node with a device is made of: the link opens with the node, the memory goes over with its state."""

from typing import Any

from palp_core.errors import DeviceError
from palp_core.graph.node.node import Node, State
from palp_core.palpation.devices.protocols import restored


class DeviceNodeState(State):
    """What a replacement inherits: what the device remembers."""

    device: Any = None


class DeviceNode(Node):
    """A node that holds a device, simulated or real, which it makes in ``on_configure``."""

    state: DeviceNodeState
    device: Any

    @property
    def memory(self) -> Any:
        """What the device remembers, held here; of a predecessor's state its plain values are left."""
        self.state.device = restored(self.device, self.state.device)
        return self.state.device

    def on_activate(self) -> None:
        self.device.open(self.now_ns(), self.memory, self.rng)

    def on_resume(self) -> None:
        self.device.open(self.now_ns(), self.memory, self.rng)

    def on_deactivate(self) -> None:
        self.device.close()

    def stop_device(self) -> None:
        """Stop a device that moves; one that cannot be reached is in the log."""
        try:
            self.device.stop(self.now_ns(), self.memory)
        except DeviceError as error:
            self.log.warning("could not be stopped: %s", error)


WATCHED_NS = 2_000_000_000
"""How long samples are counted, from the first that come."""

TOLERANCE = 0.2
"""Of the rate: less is what a bus that stumbles, or a machine that stops for a moment, loses."""


class SeenRate:
    """Counts the samples of the first two seconds: drivers make their times with the stated rate."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._begin_ns: int | None = None
        self._count = 0
        self._reported = False

    def note(self, now_ns: int, count: int) -> str | None:
        """Count samples; return a warning, once, if another number of them comes.

        >>> seen = SeenRate(1000.0)
        >>> seen.note(0, 1), seen.note(1_000_000_000, 200)
        (None, None)
        >>> seen.note(2_000_000_000, 200)
        'about 200 samples come a second, and rate_hz is 1000, by which they are timed: set rate_hz: 200'
        """
        if self._reported or (self._begin_ns is None and not count):
            return None
        if self._begin_ns is None:
            self._begin_ns = now_ns  # what had waited is of before
            return None
        self._count += count
        watched_ns = now_ns - self._begin_ns
        if watched_ns < WATCHED_NS:
            return None
        self._reported = True
        seen_hz = float(f"{self._count / (watched_ns * 1e-9):.3g}")
        if abs(seen_hz - self._rate_hz) <= TOLERANCE * self._rate_hz:
            return None
        return (
            f"about {seen_hz:g} samples come a second, and rate_hz is {self._rate_hz:g}, by which they are "
            f"timed: set rate_hz: {seen_hz:g}"
        )


class SensorNode(DeviceNode):
    """A node that drains a sensor at a rate, to the last sample when it ends.

    Its ``on_configure`` makes the device; its parameters have ``rate_hz``.
    """

    seen_rate: SeenRate | None = None
    """Counts the samples of an open sensor; None: it is not open."""

    def on_activate(self) -> None:
        self._open()

    def on_resume(self) -> None:
        self._open()

    def _open(self) -> None:
        self.device.open(self.now_ns(), self.memory, self.rng)
        self.seen_rate = SeenRate(self.params.rate_hz)  # type: ignore[attr-defined]

    def on_deactivate(self) -> None:
        if self.seen_rate is None:  # what could not be opened has nothing to drain or to close
            return
        self.drain_rest()
        self.seen_rate = None
        super().on_deactivate()

    def drain_rest(self) -> None:
        """Publish what has come since the last tick."""
        raise NotImplementedError

    def drain_device(self) -> Any:
        """Return the samples since the last call; warn once if their rate is another than ``rate_hz``."""
        samples = self.device.drain(self.now_ns(), self.memory, self.rng)
        assert self.seen_rate is not None
        if warning := self.seen_rate.note(self.now_ns(), len(samples.times_ns)):
            self.log.warning("%s", warning)
        return samples
