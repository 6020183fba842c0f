"""Task ``motion``: the joint on random gel, against solvers not palp's.

Motion is the equation of ``equilibrium/dynamics.py`` solved as it is written there by SciPy's LSODA, friction
being Coulomb's but for a turn-over at a ten-thousandth of the stage's speed. Contact forces are L2's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from benchmarks.choice_bench.contest import Case, Reading, log_between
from palp_core.errors import PalpError
from palp_core.palpation.mechanics import LayeredHertz, Scene, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics
from palp_core.palpation.mechanics.scene.fast import dynamic_sweeps
from palp_core.palpation.session.method_choices import session_quantities
from palp_core.palpation.studies.contact.scenes import near_scene, random_scene
from palp_core.units import Float64Array

_TURN_OVER = 1e-4  # of the stage's speed


def _scene(rng: np.random.Generator) -> Scene:
    return near_scene(rng) if rng.random() < 0.5 else random_scene(rng)


def _model(scene: Scene) -> LayeredHertz:
    return LayeredHertz(scene.phantoms[0], scene.probe.tip_radius_m)


@dataclass(frozen=True)
class Moving:
    """The equation of motion at one ring position.

    Attributes:
        model: The contact.
        scene: Probe and path.
        ring_m: Ring position.
        speed_m_s: Of the stage.
        setting: Inertia and damping.
        solver: Of SciPy.
        exact: Relative error that the solver allows itself; a ball that rests asks for more than one that
            slides.
    """

    model: LayeredHertz
    scene: Scene
    ring_m: float
    speed_m_s: float
    setting: Dynamics
    exact: float = 1e-9
    solver: Literal["Radau", "LSODA"] = "Radau"

    @property
    def direction(self) -> float:
        """+1.0 towards +Y."""
        return 1.0 if self.scene.path.to_m > self.scene.path.from_m else -1.0

    def _forces(self, time_s: float, angle: float, rate: float) -> tuple[float, float, float, float]:
        """Return the angular acceleration, friction, drag and normal force."""
        probe, path = self.scene.probe, self.scene.path
        lever_m = probe.lever_m
        forward_m = self.direction * path.from_m + self.speed_m_s * time_s
        normal, lateral = self.model.force(
            np.array([self.direction * (forward_m - lever_m * np.sin(angle))]),
            np.array([path.indentation_m - lever_m * (1.0 - np.cos(angle))]),
        )
        normal_n, drag_n = float(normal[0]), self.direction * float(lateral[0])
        arm_m = lever_m * np.cos(angle) + probe.tip_radius_m
        slip = (self.speed_m_s - arm_m * rate) / (_TURN_OVER * self.speed_m_s)
        friction_n = probe.friction * normal_n * np.tanh(slip)
        restoring = probe.spring_n_m(self.ring_m) + probe.weight_n_m
        moment = lever_m * (normal_n * np.sin(angle) + drag_n * np.cos(angle)) + arm_m * friction_n
        moment -= restoring * np.sin(angle) + self.setting.damping_n_m_s * rate
        return moment / self.setting.inertia_kg_m2, friction_n, drag_n, normal_n

    def torque_n_m(self, times_s: Float64Array, angle: float, rate: float) -> Float64Array:
        """Return the sensor's torque at times after a start from an angle and a rate, positive as it lags."""
        solved = scipy.integrate.solve_ivp(
            lambda t, y: (y[1], self._forces(t, y[0], y[1])[0]), (0.0, float(times_s[-1])), (angle, rate),
            method=self.solver, t_eval=times_s, rtol=self.exact, atol=1e-3 * self.exact,
        )  # fmt: skip
        if not solved.success:
            raise PalpError(f"the independent solver gave up: {solved.message}")
        probe = self.scene.probe
        torque = np.empty(times_s.size)
        for i, (t, q, w) in enumerate(zip(times_s, *solved.y, strict=True)):
            turning, friction_n, drag_n, _ = self._forces(t, q, w)
            pull_n = probe.tip_mass_kg * probe.tip_com_m * (turning * np.cos(q) - w * w * np.sin(q))
            torque[i] = probe.spring_n_m(self.ring_m) * np.sin(q) + probe.base_m * (
                friction_n + drag_n - pull_n
            )
        return torque


@dataclass(frozen=True)
class _Motion:
    scene: Scene
    output: str

    @cached_property
    def truth(self) -> Float64Array:
        """The output by ring."""
        path, model = self.scene.path, _model(self.scene)
        stage_m = path.stage_m()
        times_s: Float64Array = np.abs(stage_m - path.from_m) / path.speed_m_s
        found = []
        for ring_m in self.scene.ring_m:
            moving = Moving(model, self.scene, ring_m, path.speed_m_s, Dynamics(), exact=1e-7, solver="LSODA")
            still = sweep(model, self.scene.probe, ring_m, path.indentation_m, stage_m[:2])
            torque = moving.torque_n_m(times_s, moving.direction * float(still.angle_rad[0]), 0.0)
            found.append(_output(self.output, np.abs(torque), stage_m))
        return np.array(found)

    def measure(self, name: str, _round: int) -> Reading:
        """Return the largest error over the rings."""
        scene, model = self.scene, _model(self.scene)
        path, stage_m = scene.path, scene.path.stage_m()
        if name == "quasi_static":
            made = [sweep(model, scene.probe, one, path.indentation_m, stage_m) for one in scene.ring_m]
        else:
            made = list(dynamic_sweeps(model, scene.probe, scene.ring_m, path, stage_m))
        found = np.array([_output(self.output, np.abs(one.torque_n_m), stage_m) for one in made])
        return Reading(float(np.max(np.abs(found / self.truth - 1.0))))


def _output(output: str, torque: Float64Array, stage_m: Float64Array) -> float:
    """Return the peak, or it over the line between the ends."""
    at = int(np.argmax(torque))
    if output == "peak":
        return float(torque[at])
    return float(torque[at] - np.interp(stage_m[at], *_rising(stage_m[[0, -1]], torque[[0, -1]])))


def _rising(x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
    order = np.argsort(x)
    return x[order], y[order]


def motion(rng: np.random.Generator, _index: int) -> Case:
    """Draw a whole sweep at 10 to 500 mm/s, half of them slower than 50."""
    scene = _scene(rng)
    speed_m_s = log_between(rng, 0.01, 0.05) if rng.random() < 0.5 else log_between(rng, 0.05, 0.5)
    output = str(rng.choice(["peak", "contrast"]))
    if scene.phantom.bead is None:
        output = "peak"
    asked = replace(scene, path=replace(scene.path, speed_m_s=speed_m_s))
    moved = _Motion(asked, output)
    _ = moved.truth
    rings = " and ".join(f"{one * 1e3:.3g}" for one in scene.ring_m)
    words = f"{speed_m_s * 1e3:.3g} mm/s, rings {rings} mm, {scene.phantom.modulus_pa:.3g} Pa"
    tolerance = log_between(rng, 3e-3, 0.2)
    return Case("motion", output, tolerance, session_quantities(asked), moved.measure, words)


CONTESTS: dict[str, Callable[[np.random.Generator, int], Case]] = {"motion": motion}
