"""Sweeps over a mounted phantom as they come: which is under way, and what it feels like."""

from __future__ import annotations

from dataclasses import dataclass, field

from palp_core.palpation.mechanics.scene.rig import Rig
from palp_core.palpation.world.luck import Luck
from palp_core.palpation.world.model import WorldModel
from palp_core.palpation.world.touch import Touch, touch
from palp_core.palpation.world.trace import WorldTrace, trace
from palp_core.units import Float64Array

_ALIKE_M = 1e-4  # sweeps that begin so near each other are one


@dataclass
class LiveSweeps:
    """The sweeps of one mounting and ring: solved once per way of making them, each with its own phase.

    Attributes:
        touch: Contact with the phantom.
        luck: Of the session.
        row: Latents of the mounting, shape (7,).
        surface: Random numbers of its track.
        ring_m: True position of the ring.
        ends_m: Lower and upper end of what a sweep may reach.
    """

    touch: Touch
    luck: Luck
    row: Float64Array
    surface: Float64Array
    ring_m: float
    ends_m: tuple[float, float]
    _solved: dict[tuple[float, bool, float, float], WorldTrace] = field(default_factory=dict)

    def of(
        self,
        from_m: float,
        sweep: int,
        speed_m_s: float,
        *,
        forward: bool,
        indentation_m: float | None = None,
    ) -> WorldTrace:
        """Return the sweep that was lowered at a position.

        Args:
            from_m: Where.
            sweep: Its number: says at which share of a cycle a stick-slip begins.
            speed_m_s: Of the stage.
            forward: Whether it goes towards +Y.
            indentation_m: Nominal indentation; None: the session's.

        Raises:
            MechanicsError: It has no solution.
        """
        start = round(from_m / _ALIKE_M) * _ALIKE_M
        pressed_m = self.luck.indentation_m if indentation_m is None else indentation_m
        key = (start, forward, speed_m_s, pressed_m)
        if key not in self._solved:
            self._solved[key] = trace(
                self.touch,
                self.luck.world,
                self.row,
                self.surface,
                self.ring_m,
                pressed_m,
                start,
                self.ends_m[1] if forward else self.ends_m[0],
                speed_m_s=speed_m_s,
            )
        return self._solved[key].again(self.luck.phase(sweep))


@dataclass
class LiveWorld:
    """A simulated rig's touch in a world: phantoms by code, and the luck of its session.

    Attributes:
        rig: What is touched, and with what.
        luck: Of the session.
        ends_m: Lower and upper end of what a sweep may reach.
    """

    rig: Rig
    luck: Luck
    ends_m: tuple[float, float]
    _touches: dict[str, Touch] = field(default_factory=dict)

    def row(self, code: str, mounting: int, height_m: float, path_m: float) -> Float64Array:
        """Return the latents of a mounting, shape (7,); arguments as of :meth:`.Luck.row`."""
        return self.luck.row(code, self.rig.phantoms[code], mounting, height_m, path_m)

    def sweeps(self, code: str, mounting: int, ring_m: float, height_m: float, path_m: float) -> LiveSweeps:
        """Return the sweeps of a mounting and ring.

        Args:
            code: The phantom.
            mounting: Number of the mounting.
            ring_m: True position of the ring.
            height_m: Of the surface over nominal.
            path_m: What the tip has swept so far.
        """
        if not self._touches:  # all at once, and in an order that tells nothing of the one that is on
            self._touches = {one: self._touch(one) for one in self.rig.by_depth}
        row = self.row(code, mounting, height_m, path_m)
        surface = self.luck.track(mounting)
        return LiveSweeps(self._touches[code], self.luck, row, surface, ring_m, self.ends_m)

    def _touch(self, code: str) -> Touch:
        world = self.luck.world
        tips = world.tip_radius_session_sd_m > 0.0 or world.tip_wear_per_m != 0.0
        name = self.rig.choices[code].method.name
        return touch(self.rig.phantoms[code], self.rig.probe, name, tips=tips)


def live_world(rig: Rig, world: WorldModel, seed: int, from_m: float, to_m: float) -> LiveWorld:
    """Return a rig's touch in a world.

    Args:
        rig: What is touched, and with what.
        world: What is on.
        seed: Of the session's luck.
        from_m: One end of what a sweep may reach.
        to_m: The other.
    """
    luck = Luck(world, seed, rig.probe, rig.indentation_m)
    return LiveWorld(rig, luck, (min(from_m, to_m), max(from_m, to_m)))
