"""A scene swept: what ``palp scene run`` prints."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.methods import outside
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.dynamics import simulate
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep, sweep
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import SceneChoice, choose_rung, rung_model
from palp_core.palpation.mechanics.scene.guard import speed_guard, sweep_guards
from palp_core.palpation.mechanics.scene.output import contrast_n_m, grid_m, peak_n_m
from palp_core.palpation.mechanics.scene.scene import Scene, StagePath
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class SceneRun:
    """A scene's sweeps, one per ring position."""

    choice: SceneChoice  # The rung, its bound, the reason
    ring_m: tuple[float, ...]  # Ring positions
    sweeps: tuple[Sweep, ...]  # One per ring, all at the same stage positions
    peak_n_m: tuple[float, ...]  # Largest torque per ring
    contrast_n_m: tuple[float, ...]  # That minus its local base
    # What the run met: the region in which a method fails, and what took over there
    guards: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """Return the run as plain lists and numbers, SI."""
        return {
            "ring_m": list(self.ring_m),
            "stage_m": self.sweeps[0].stage_m.tolist(),
            "torque_n_m": [one.torque_n_m.tolist() for one in self.sweeps],
            "angle_rad": [one.angle_rad.tolist() for one in self.sweeps],
            "normal_n": [one.normal_n.tolist() for one in self.sweeps],
            "peak_n_m": list(self.peak_n_m),
            "contrast_n_m": list(self.contrast_n_m),
            "rung": self.choice.rung,
            "bound": self.choice.bound,
            "motion": self.choice.motion.name,
            "guards": list(self.guards),
        }


def _swept(model: ContactModel, scene: Scene, stage_m: Float64Array, *, moving: bool) -> tuple[Sweep, ...]:
    """Return one sweep per ring position, with inertia where the scene needs it."""
    if moving:
        return _dynamic_sweeps(model, scene.probe, scene.ring_m, scene.path, stage_m)
    depth_m = scene.path.indentation_m
    return tuple(sweep(model, scene.probe, ring_m, depth_m, stage_m) for ring_m in scene.ring_m)


def run_scene(scene: Scene, rung: str | None = None) -> SceneRun:
    """Sweep a scene at each of its ring positions.

    Args:
        scene: What is swept.
        rung: Name of a rung to take regardless of the tolerance; None for the cheapest that is good enough.

    Raises:
        MethodError: No rung is good enough.
        MechanicsError: The rung has no answer for this phantom, or there is no equilibrium.
    """
    choice = choose_rung(scene, rung)
    model = rung_model(choice.rung, scene.phantom, scene.probe.tip_radius_m)
    stage = grid_m(scene)
    sweeps = _swept(model, scene, stage, moving=choice.motion.name == "dynamic")
    guards = tuple(
        f"ring_m = {ring_m:g}: {words}"
        for ring_m, one in zip(scene.ring_m, sweeps, strict=True)
        for words in sweep_guards(scene.phantom, scene.probe, choice.rung, one)
    )
    strayed = outside("contact", choice.rung, scene.quantities())
    guards = (*([strayed] if strayed else ()), *speed_guard(choice.motion), *guards)
    return SceneRun(
        choice=choice,
        ring_m=scene.ring_m,
        sweeps=sweeps,
        peak_n_m=tuple(peak_n_m(one) for one in sweeps),
        contrast_n_m=tuple(contrast_n_m(one) for one in sweeps),
        guards=guards,
    )


def _dynamic_sweeps(
    model: ContactModel, probe: Probe, ring_m: Sequence[float], path: StagePath, stage_m: Float64Array
) -> tuple[Sweep, ...]:
    """Return one sweep per ring position, the joint's inertia and implicit friction included.

    Between time steps angle, torque and normal force are read off linearly; contact and place follow from the
    angle.
    """
    moved = simulate(model, probe, ring_m, path.indentation_m, path.from_m, path.to_m, path.speed_m_s)
    order = slice(None) if path.to_m > path.from_m else slice(None, None, -1)

    def read(values: Float64Array) -> Float64Array:
        return np.interp(stage_m, moved.stage_m[order], values[order])

    made = []
    for i in range(len(ring_m)):
        angle_rad = read(moved.angle_rad[i])
        offset_m = stage_m - probe.lever_m * np.sin(angle_rad)
        depth_m = path.indentation_m - probe.lever_m * (1.0 - np.cos(angle_rad))
        made.append(
            Sweep(
                stage_m=stage_m,
                angle_rad=angle_rad,
                torque_n_m=read(moved.torque_n_m[i]),
                normal_n=read(moved.normal_n[i]),
                lateral_n=model.force(offset_m, depth_m)[1],
                offset_m=offset_m,
                indentation_m=depth_m,
                lifted=depth_m <= 0.0,
                root_count=np.ones(stage_m.size, dtype=np.int64),
                snap_at=(),
            )
        )
    return tuple(made)
