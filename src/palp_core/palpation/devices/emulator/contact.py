"""The phantom under the probe of an emulated rig: what stage and ring do to it, and what the sensor feels.

The force follows from the stage's position and the ring by the same mechanics as the simulated rig. Above the
scanning height the contact fades with indentation to the power 1.5 (Hertz, sphere on a half space) and ends
where the ball leaves the surface; at the ends of the solved stretch it stays as it is. While the ring moves,
the contact is that of the place it goes to: on a rig that palpates, the probe is raised then.
"""

import math
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator.axis import Axes
from palp_core.palpation.devices.emulator.maestro import EmulatedRod
from palp_core.palpation.mechanics import ContactModel, solve
from palp_core.palpation.mechanics.scene.guard import speed_guard
from palp_core.palpation.mechanics.scene.rig import Rig, rig
from palp_core.palpation.world.draws import SessionSweeps, open_world
from palp_core.palpation.world.model import PAPER, WorldModel
from palp_core.units import Float64Array

_STEP_M = 50e-6
_LOWEST_RING_M = -0.6e-3  # twice the actuator's repeatability; the joint is unstable from -1 mm on
_MOST_GUARDS = 100_000
SPEED_M_S = 0.02
"""Of the sweeps whose stick-slip is solved for: the published one."""


@dataclass(frozen=True)
class ContactSettings:
    """What the probe touches.

    Attributes:
        touch: Arguments of :func:`.rig`: phantoms, scene, what the contact must get right, indentation ...
        code: The phantom that is mounted first; empty for the first of the file.
        height_offset_m: How much higher than nominal it is mounted.
        from_m: Lower end of the solved stretch.
        to_m: Upper end.
        world: What phantoms and probe have that the paper's own design has not.
        lands_m: Where the probe is lowered for a sweep towards +Y, and towards -Y; None: the stretch's ends.
    """

    touch: dict[str, Any] = field(default_factory=dict)
    code: str = ""
    height_offset_m: float = 0.0
    from_m: float = -0.032
    to_m: float = 0.052
    world: WorldModel = PAPER
    lands_m: tuple[float, float] | None = None


@dataclass(frozen=True)
class GuardMet:
    """What the mechanics have to say of the contact that the probe felt: a region in which a method fails."""

    code: str
    ring_m: float
    words: tuple[str, ...]


class ProbeContact:
    """The contact of probe and phantom. Used by one thread; a second one solves sweeps.

    Args:
        settings: What is touched.
        axes: Where the probe is.
        rod: Where the ring is.
        seed: Of the world's random numbers.
        ahead: Solve before anything is felt: for a sensor that may not wait.
    """

    def __init__(
        self, settings: ContactSettings, axes: Axes, rod: EmulatedRod, seed: int, *, ahead: bool
    ) -> None:
        self.settings, self._axes, self._rod, self._ahead = settings, axes, rod, ahead
        try:
            self.rig = rig(**settings.touch)
        except TypeError as error:
            raise DeviceError(f"emulator: touch: {error}; see palp_core.palpation.mechanics") from error
        self._models = {code: self.rig.model(code) for code in self.rig.by_depth}
        self._ends_m = settings.from_m, settings.to_m
        self._live = open_world(self.rig, settings.world, seed, *self._ends_m)
        self._solver = ThreadPoolExecutor(1, thread_name_prefix="palp-emulator-mechanics")
        self._way_m, self._last_m, self._mounting, self._forward = 0.0, 0.0, 0, True
        self.swept_m_s = 0.0
        self.guards: deque[GuardMet] = deque(maxlen=_MOST_GUARDS)
        self._met: GuardMet | None = None
        self._met_m_s = 0.0
        self._met_words: tuple[str, ...] = ()
        self.mount(settings.code or min(self.rig.phantoms), settings.height_offset_m)

    def mount(self, code: str, height_offset_m: float) -> None:
        """Put a phantom under the probe."""
        known = self.rig.phantoms
        if code not in known:
            raise DeviceError(f"emulator: no phantom '{code}'; there are {', '.join(sorted(known))}")
        self._code, self._height_m, self._mounting = code, height_offset_m, self._mounting + 1
        self._pressed_m, self._solved_for_m = self.rig.indentation_m + height_offset_m, math.nan
        if self._ahead:
            self._solve()

    def latents(self) -> Float64Array:
        """Return what the mounted phantom is off by, shape (7,), as of :data:`.LATENTS`."""
        return self._live.row(self._code, self._mounting, self._height_m, self._way_m)

    def loads(self, now_ns: int) -> list[float]:
        """Return lateral and normal force in N and the torque in N m: it is asked for at every sample."""
        if self._rod.lands_m != self._solved_for_m:
            self._solve()
        at_m = self._axes.y.position_m(now_ns)
        share = (self._pressed_m - self._axes.z.position_m(now_ns)) / self._pressed_m
        loads = [0.0, 0.0, 0.0]
        if share > 0.0:
            curve, guard = self._contact.result()
            move = self._axes.y.profile
            if now_ns < move.end_ns:
                self.swept_m_s = move.speed_m_per_s
            if guard is not self._met or self.swept_m_s != self._met_m_s:
                self._meet(guard)
            if at_m != self._last_m:
                self._forward = at_m > self._last_m
                self._way_m += abs(at_m - self._last_m)
            curve = curve[0 if self._forward else -1]
            place = min(max((at_m - self._ends_m[0]) / _STEP_M, 0.0), len(curve) - 1.001)
            below, part = int(place), place % 1.0
            faded = min(share, 1.0) ** 1.5
            loads = [
                (before * (1.0 - part) + after * part) * faded
                for before, after in zip(curve[below].tolist(), curve[below + 1].tolist(), strict=True)
            ]
        self._last_m = at_m
        return loads

    def close(self) -> None:
        """End the solver's thread."""
        self._solver.shutdown(wait=True, cancel_futures=True)

    def _meet(self, met: GuardMet) -> None:
        """Note what a contact meets at the present speed of the stage, where that is new."""
        words = met.words
        if self.swept_m_s:
            words += speed_guard(self.rig.motion(self.swept_m_s))
        before = self._met_words if met is self._met else ()
        self._met, self._met_m_s, self._met_words = met, self.swept_m_s, words
        if words != before:
            self.guards.append(replace(met, words=words))

    def _solve(self) -> None:
        """Begin to solve the sweeps of this mounting and of where the ring lands."""
        self._solved_for_m = self._rod.lands_m
        ring_m = max(_LOWEST_RING_M, self._solved_for_m)
        self._contact: Future[tuple[Float64Array, GuardMet]]
        if self.settings.world.plain:
            model = self._models[self._code]
            self._contact = self._solver.submit(
                _solved, self.rig, self._code, model, ring_m, self._pressed_m, self._ends_m
            )
        else:
            sweeps = self._live.sweeps(self._code, self._mounting, ring_m, self._height_m, self._way_m)
            lands_m = self.settings.lands_m or self._ends_m
            self._contact = self._solver.submit(
                _solved_in_world, self.rig, self._code, sweeps, self._mounting, lands_m
            )


def _solved(
    rig: Rig,
    code: str,
    model: ContactModel,
    ring_m: float,
    indentation_m: float,
    ends_m: tuple[float, float],
) -> tuple[Float64Array, GuardMet]:
    """Return lateral and normal force and torque at every step of the stretch, shape (1, n, 3), and guards.

    A straight line over 50 um misses a curve of the nodule's width by a few nN m.
    """
    table = solve(model, rig.probe, ring_m, indentation_m, *ends_m)
    stage_m = np.clip(_steps_m(ends_m), table.low_m, table.high_m)
    loads = np.column_stack([table.lateral_n(stage_m), table.normal_n(stage_m), table.torque_n_m(stage_m)])
    return loads[None], GuardMet(code, ring_m, rig.met(code, table.solved))


def _solved_in_world(
    rig: Rig, code: str, sweeps: SessionSweeps, mounting: int, lands_m: tuple[float, float]
) -> tuple[Float64Array, GuardMet]:
    """Return the same in a world, of a sweep there and of one back, shape (2, n, 3)."""
    stage_m = _steps_m(sweeps.ends_m)
    both = [
        sweeps.of(lands_m[0], mounting, SPEED_M_S, forward=True),
        sweeps.of(lands_m[1], mounting, SPEED_M_S, forward=False),
    ]
    loads = [
        np.column_stack([one.lateral_n(stage_m), one.normal_n(stage_m), one.torque_n_m(stage_m)])
        for one in both
    ]
    return np.stack(loads), GuardMet(code, sweeps.ring_m, rig.met(code, both[0].solved))


def _steps_m(ends_m: tuple[float, float]) -> Float64Array:
    from_m, to_m = ends_m
    return np.asarray(from_m + _STEP_M * np.arange(round((to_m - from_m) / _STEP_M) + 1), np.float64)
