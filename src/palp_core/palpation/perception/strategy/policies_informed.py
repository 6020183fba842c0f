"""Policies that use more than the belief: landings of the ring, shared errors, or a person's EMG.

Task ``policy``, with those of :mod:`policies`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.information import expected_gains_bits
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.rig_noise import independent_model
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import RingChoice, UniformDraw, everywhere
from palp_core.units import Float64Array

_TIE = 1e-9  # bits, or bits per second; far below what one probe gives


@dataclass(frozen=True)
class Timing:
    """How long a probe takes on the rig."""

    # Sweep and way back; 80 mm at the published 20 mm/s, twice (length and way back assumed)
    sweep_s: float = 8.0
    ring_m_per_s: float = 5.0e-3  # Speed of the ring (older data sheets of the actuator: 5 mm/s)
    settle_s: float = 0.2  # From the ring's arrival to rest (assumed)
    home_m: float = 1.0e-3  # From the ring's zero to the stop it is re-homed at (assumed)
    rehomes: bool = True  # Whether a trial begins at that stop

    def move_s(self, from_m: Float64Array, to_m: Float64Array) -> Float64Array:
        """Return the time to travel between ring positions; 0 where nothing moves."""
        way_m = np.abs(np.asarray(to_m) - np.asarray(from_m))
        return np.where(way_m > 0.0, way_m / self.ring_m_per_s + self.settle_s, 0.0)

    def renew_s(self, ring_m: Float64Array) -> Float64Array:
        """Return the time to go to the stop and back to a ring position."""
        return 2.0 * (np.asarray(ring_m) + self.home_m) / self.ring_m_per_s + self.settle_s


@dataclass(frozen=True)
class Reposition:
    """Keep one ring position but land on it again before every probe, so that its error averages out."""

    ring_m: float = 0.016  # That position, m

    @property
    def rings_m(self) -> tuple[float, ...]:
        """The one position, m."""
        return (self.ring_m,)

    def start(self, uniform: UniformDraw, trial_count: int | None = None) -> RingChoice:
        return everywhere(0, trial_count)

    def step(self, at: RingChoice, belief: latent.Belief, uniform: UniformDraw) -> RingChoice:
        return RingChoice.at(at.level, renew=True)


@dataclass(frozen=True)
class EmgDriven:
    """Follow the co-contraction of a person who palpates at the same time."""

    latest: int | None = None  # Level of the latest burst, as an index; None before the first
    start_level: int = 2  # Level until then (assumed: the middle)
    rings_m: tuple[float, ...] = figure5.RINGS_M  # Ring position of each level, m; Table 6

    def __post_init__(self) -> None:
        for level in (self.start_level, *([] if self.latest is None else [self.latest])):
            if not 0 <= level < len(self.rings_m):
                raise PerceptionError(
                    f"co-contraction level {level} has no ring position; there are {len(self.rings_m)}"
                )

    def start(self, uniform: UniformDraw, trial_count: int | None = None) -> RingChoice:
        return everywhere(self.start_level if self.latest is None else self.latest, trial_count)

    def step(self, at: RingChoice, belief: latent.Belief, uniform: UniformDraw) -> RingChoice:
        return RingChoice.at(at.level if self.latest is None else np.full_like(at.level, self.latest))


@dataclass(frozen=True, eq=False)
class Actions:
    """What could be done next, one column per action, and what it promises."""

    # Ring level of each action, shape (k + 1,); the last is to stay, whose level is the present one
    level: NDArray[np.int64]
    gain_bits: Float64Array  # Expected information gain, shape (..., k + 1); minus infinity: no such action
    seconds: Float64Array  # Duration of move and sweep, shape (..., k + 1)


@dataclass(frozen=True, eq=False)
class InformationGainLatent:
    """Probe where the next reading shows most about the class, knowing which errors stay in the trial.

    A probe without a move is expected to repeat the present offset, one after a move to the same position to
    draw a new one: whether that is worth a probe follows from the model and is not built in.

    Attributes:
        model: Readings and what stays; with no offsets it is plain information gain.
        rings_m: Ring position of each setting, m, shape (k,).
        per_second: Whether to weigh by time: bits per second instead of bits.
        timing: How long moves and sweeps take.
        node_count: Quadrature nodes per class.
    """

    model: latent.OffsetModel
    rings_m: tuple[float, ...] = figure5.RINGS_M
    per_second: bool = False
    timing: Timing = Timing()
    node_count: int = 33

    def start(self, uniform: UniformDraw, trial_count: int | None = None) -> RingChoice:
        level, _ = self.best(latent.start(self.model, trial_count), None)
        return RingChoice.at(level)

    def step(self, at: RingChoice, belief: latent.Belief, uniform: UniformDraw) -> RingChoice:
        """Return the next levels from what is known of the classes and of the model's offsets."""
        level, renew = self.best(belief, at.level)
        return RingChoice.at(level, renew=renew)

    def best(
        self, belief: latent.Belief, level: ArrayLike | None
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the level (...) of the best action and whether it positions again where the ring already is.

        Args:
            belief: Of one trial, or of many with a leading dimension.
            level: Present level, shape (...); None before the first probe.
        """
        actions = self.actions(belief, level)
        value = actions.gain_bits / actions.seconds if self.per_second else actions.gain_bits
        value[..., -1] += _TIE  # where nothing stays, staying gives as much as a new landing and is no work
        choice = np.argmax(value, axis=-1)
        count = len(self.rings_m)
        if level is None:
            return choice, np.zeros_like(choice, dtype=bool)
        chosen = np.where(choice == count, np.asarray(level, dtype=np.int64), choice)
        return chosen, (choice < count) & (chosen == level)

    def actions(self, belief: latent.Belief, level: ArrayLike | None) -> Actions:
        """Return what every move, and staying, promises."""
        count, rings = len(self.rings_m), np.asarray(self.rings_m)
        lead = belief.log_class.shape[:-1]
        here = np.zeros(lead, dtype=np.int64) if level is None else np.asarray(level, dtype=np.int64)
        if self.model.offset_sd.size == 0:  # nothing stays: a reading is alike for all beliefs, moved or not
            means, sds = self.model.mean[..., 0].T, np.sqrt(self.model.noise[..., 0, 0]).T
            moves = expected_gains_bits(belief.posterior, means, sds, node_count=self.node_count)
            stay = np.take_along_axis(moves, here[..., None], axis=-1)
            gains = np.concatenate([moves, stay], axis=-1)
        else:
            gains = self._gains(belief, here)
        seconds = np.full(gains.shape, self.timing.sweep_s)
        if level is None:
            gains[..., -1] = -np.inf
        else:
            move = self.timing.move_s(rings[here][..., None], rings)
            renew = np.where(np.arange(count) == here[..., None], self.timing.renew_s(rings), move)
            seconds[..., :count] += renew
        return Actions(np.append(np.arange(count), -1), gains, seconds)

    def _gains(self, belief: latent.Belief, here: NDArray[np.int64]) -> Float64Array:
        """Return what a reading at every level, landed on again, and one without a move give, in bits."""
        lead = belief.log_class.shape[:-1]
        fresh = latent.renewed(self.model, belief, np.ones(lead, dtype=bool))
        found = [latent.predict(self.model, fresh, np.full(lead, k)) for k in range(len(self.rings_m))]
        found.append(latent.predict(self.model, belief, here))
        means = np.stack([centre[..., 0] for centre, _ in found], axis=-2)
        sds = np.sqrt(np.stack([spread[..., 0, 0] for _, spread in found], axis=-2))
        return expected_gains_bits(belief.posterior, means, sds, node_count=self.node_count)


def information_gain(primitives: Primitives) -> InformationGainLatent:
    """Return the policy that takes every reading for independent: plain information gain, one step ahead."""
    return InformationGainLatent(independent_model(primitives), tuple(primitives.rings_m.tolist()))
