"""What can be done next, and what it is expected to tell: ring, indentation, speed, path and direction."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.belief import TraceBelief
from palp_core.palpation.perception.trace.information import expected_bits
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.units import Float64Array


@dataclass(frozen=True, order=True)
class SweepAction:
    """One sweep.

    Attributes:
        ring_m: Position of the ring.
        indentation_m: Nominal indentation of the upright probe.
        speed_m_per_s: Of the stage along the path.
        from_m: Stage position at which the path begins.
        to_m: Where it ends; smaller than ``from_m``: swept back.

    Raises:
        PerceptionError: A number is not finite, there is no way to go, or no speed.
    """

    ring_m: float
    indentation_m: float
    speed_m_per_s: float
    from_m: float
    to_m: float

    def __post_init__(self) -> None:
        numbers = (self.ring_m, self.indentation_m, self.speed_m_per_s, self.from_m, self.to_m)
        if not all(map(math.isfinite, numbers)) or self.speed_m_per_s <= 0.0 or self.way_m < 1e-6:
            raise PerceptionError(
                f"a sweep from {self.from_m:g} to {self.to_m:g} m at {self.speed_m_per_s:g} m/s, ring at "
                f"{self.ring_m:g} m, {self.indentation_m:g} m deep: give finite numbers, a way and a speed"
            )

    @property
    def backward(self) -> bool:
        """Whether the stage goes towards -Y."""
        return self.to_m < self.from_m

    @property
    def way_m(self) -> float:
        """Length of the path."""
        return abs(self.to_m - self.from_m)

    @property
    def sign(self) -> float:
        """-1.0 for a sweep back, else 1.0."""
        return -1.0 if self.backward else 1.0


@dataclass(frozen=True)
class LoadLimits:
    """What no sweep may come to.

    Attributes:
        torque_n_m: Largest torque.
        force_n: Largest normal force.
        spreads: Standard deviations that count as expected.
    """

    torque_n_m: float
    force_n: float
    spreads: float = 3.0

    def refusal(self, torque_n_m: float, force_n: float) -> str:
        """Return why a sweep of such a torque and force is refused; empty if it is not."""
        if not torque_n_m < self.torque_n_m:
            return f"a torque of {torque_n_m * 1e3:.3g} N mm may come; the limit is {self.torque_n_m * 1e3:g}"
        if not force_n < self.force_n:
            return f"a force of {force_n:.3g} N may come; the limit is {self.force_n:g}"
        return ""


@dataclass(frozen=True, eq=False)
class ActionModel:
    """What sweeps look like, and which of them are offered.

    Attributes:
        model: Of sweeps; torques of one that goes the other way than training's count with the other sign.
        offered: The actions to choose among.
        setting: The model's setting of each, length a.
        bins: How many of its bins each sweeps, length a.
        refused: Why others are not offered.

    Raises:
        PerceptionError: None is left.
    """

    model: TraceModel
    offered: tuple[SweepAction, ...]
    setting: tuple[int, ...]
    bins: tuple[int, ...]
    refused: Mapping[SweepAction, str]

    def __post_init__(self) -> None:
        if not self.offered:
            why = next(iter(self.refused.values()), "none was named")
            raise PerceptionError(f"no action is left to choose: {why}")

    def only(self, wanted: Collection[SweepAction]) -> ActionModel:
        """Return the model with some of its actions on offer.

        Raises:
            PerceptionError: It offers none of them.
        """
        kept = [number for number, action in enumerate(self.offered) if action in wanted]
        return ActionModel(
            self.model,
            tuple(self.offered[number] for number in kept),
            tuple(self.setting[number] for number in kept),
            tuple(self.bins[number] for number in kept),
            {action: why for action, why in self.refused.items() if action in wanted},
        )

    def expected_bits(self, belief: TraceBelief, ring_m: float | None) -> Float64Array:
        """Return what each action is expected to tell, shape (n, a), in bits: a lower bound.

        Args:
            belief: Of trials that were swept alike.
            ring_m: Where the ring is; None: nowhere yet, it lands anew whatever is chosen.
        """
        return np.stack(
            [
                expected_bits(self.model, belief, setting, landed=action.ring_m != ring_m, bins=bins)
                for action, setting, bins in zip(self.offered, self.setting, self.bins, strict=True)
            ],
            axis=1,
        )

    def best(
        self, belief: TraceBelief, ring_m: float | None, seconds: Float64Array
    ) -> tuple[NDArray[np.int64], Float64Array]:
        """Return :func:`most_a_second` of trials that were swept alike.

        Args:
            belief: Theirs.
            ring_m: Where the ring is.
            seconds: What each action takes of the rig, shape (a,).
        """
        return most_a_second(self.expected_bits(belief, ring_m), seconds)


def most_a_second(bits: Float64Array, seconds: Float64Array) -> tuple[NDArray[np.int64], Float64Array]:
    """Return the action of the most bits a second of each trial, by index, and these bits, shape (n,).

    Of actions that promise the same the first counts.

    Args:
        bits: What each action is expected to tell, shape (n, a).
        seconds: What each takes of the rig, shape (a,).
    """
    chosen = np.asarray(np.argmax(bits / seconds, axis=1), dtype=np.int64)
    return chosen, np.take_along_axis(bits, chosen[:, None], axis=1)[:, 0]
