"""The rod of the emulated ring actuator: the simulated ring, by its own potentiometer and in truth."""

from dataclasses import replace

import numpy as np

from palp_core.palpation.devices.sim.ring import SimRing, SimRingState


class EmulatedRod:
    """A simulated ring that counts from the retracted stop, as its controller does."""

    def __init__(self, ring: SimRing, seed: int) -> None:
        self._zero_m = ring.zero_m
        self._ring = replace(ring, zero_m=0.0, settle_s=0.0, feedback_step_m=0.0)
        self._state, self._rng = SimRingState(), np.random.default_rng(seed)
        self._ring.open(0, self._state, self._rng)
        self.stalled = False

    @property
    def stroke_m(self) -> float:
        """Stop to stop."""
        return self._ring.stroke_m

    def move(self, extension_m: float, speed_m_per_s: float, now_ns: int) -> None:
        """Send the rod to an extension; the true landing error is drawn here."""
        if not self.stalled:
            self._ring = replace(self._ring, speed_m_per_s=speed_m_per_s)
            target_m = min(max(extension_m, 0.0), self.stroke_m)
            self._ring.command(target_m, now_ns, self._state, self._rng)

    def stall(self, now_ns: int) -> None:
        """Block the rod where it is."""
        self._ring.stop(now_ns, self._state)
        self.stalled = True

    def extension_m(self, now_ns: int) -> float:
        """Return where the rod is by its own potentiometer."""
        return self._ring.read(now_ns, self._state).measured_m

    def ring_m(self, now_ns: int) -> float:
        """Return where the ring is in truth."""
        return self._ring.true_position_m(now_ns, self._state) - self._zero_m

    @property
    def lands_m(self) -> float:
        """Where the ring is in truth once the rod rests."""
        return self._state.true_m[-1] - self._zero_m
