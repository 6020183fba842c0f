"""A device whose promises are checked, with its state and its time."""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palp_core.counted import counted
from palp_core.errors import DeviceError
from palp_core.graph.clock import monotonic_ns
from palp_core.palpation.devices.registry import open_device


class PromiseBroken(AssertionError):
    """A device does not do what its kind promises; the text says what."""


def must(holds: object, words: str) -> None:
    """Say in words what does not hold.

    Raises:
        PromiseBroken: It does not.
    """
    if not holds:
        raise PromiseBroken(words)


@contextlib.contextmanager
def refused(words: str, what: str) -> Iterator[None]:
    """Expect that a device refuses something, with a message in which there are these words.

    Raises:
        PromiseBroken: It accepts, or the message is another.
    """
    try:
        yield
    except DeviceError as error:
        must(re.search(words, str(error)), f"it refuses {what}, but does not say '{words}': {error}")
        return
    raise PromiseBroken(f"it does not refuse {what} (with a DeviceError that says '{words}')")


@dataclass
class Patience:
    """Wait for what a device does, never for a length of time."""

    longest_s: float = 60.0

    def until(self, holds: Callable[[], object], what: str = "") -> None:
        """Ask again and again until it holds.

        Raises:
            PromiseBroken: It does not for too long.
        """
        pause, end_ns = threading.Event(), monotonic_ns() + round(self.longest_s * 1e9)
        while not holds():
            must(monotonic_ns() < end_ns, f"waited {self.longest_s:g} s in vain {what}".rstrip())
            pause.wait(0.002)


@dataclass
class Subject:
    """A device under test.

    Attributes:
        kind: ``stage``, ``ring``, ``torque`` or ``emg``.
        name: Of its back end, or ``module:Class``.
        options: Of its driver.
        patience: For what it does in its own time.
        simulated: It goes by the time that it is told, not by the machine's.
    """

    kind: str
    name: str
    options: dict[str, Any]
    patience: Patience = field(default_factory=Patience)
    simulated: bool = False
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    sim_ns: int = 0
    device: Any = None
    state: Any = None

    def __post_init__(self) -> None:
        self.device = self.make()
        self.state = self.device.state_type()

    def make(self) -> Any:
        """Return another of its kind, with no link yet."""
        return open_device(self.kind, self.name, **self.options)  # type: ignore[call-overload]

    def now(self) -> int:
        """Return the time, ns."""
        return self.sim_ns if self.simulated else monotonic_ns()

    def open(self) -> Any:
        """Open its link and return it."""
        self.device.open(self.now(), self.state, self.rng)
        return self.device

    def reach(self, at_ns: int) -> None:
        """Let the time come."""
        if self.simulated:
            self.sim_ns = max(self.sim_ns, at_ns)
        else:
            self.patience.until(lambda: monotonic_ns() >= at_ns)

    def rest(self) -> None:
        """Wait for a stage to stand still."""
        self.patience.until(
            lambda: not self.device.feedback(self.now(), self.state).moving, "for the stage to stand still"
        )

    def collect(self, count: int) -> list[Any]:
        """Drain blocks until there are so many samples."""
        blocks: list[Any] = []

        def enough() -> bool:
            self.sim_ns += 10_000_000
            blocks.append(self.device.drain(self.now(), self.state, self.rng))
            return sum(len(block.times_ns) for block in blocks) >= count

        self.patience.until(enough, f"for {counted(count, 'sample')}")
        return [block for block in blocks if len(block.times_ns)]
