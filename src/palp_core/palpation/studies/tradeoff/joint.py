"""Tasks ``equilibrium``, ``friction`` and ``motion``, measured in a scene.

The contact below is L2 throughout: how well a joint is solved does not depend on whose forces it is solved
with, and L2's cost nothing.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.methods import find, methods, task
from palp_core.methods.machine import slowness
from palp_core.methods.measured import Measured, begins_after, cpu_s
from palp_core.palpation.mechanics import LayeredHertz, Scene, equilibria, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, DynamicSweep, simulate
from palp_core.palpation.mechanics.equilibrium.friction import Slip
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.scene.fast import dynamic_sweeps
from palp_core.palpation.mechanics.scene.output import contrast_n_m, peak_n_m
from palp_core.palpation.mechanics.scene.scene import motion_output
from palp_core.units import Float64Array

_POSITIONS = 81
_RUN_POSITIONS = 3000  # of a sweep as runs solve it: its set-up is shared among so many
_LONG_S = 3.0
_CHATTER = 0.2  # change of the slip in a step, over the stage's speed, as in the study contact-stability
_FAST_M_S = (0.05, 0.2)
_FINE_S = 1e-5
_CREEP_M_S, _REST_S = 0.0005, 0.05


def _model(scene: Scene) -> LayeredHertz:
    return LayeredHertz(scene.phantoms[0], scene.probe.tip_radius_m, tip=scene.probe.tip)


@begins_after(0.2)
def measure_equilibrium(scene: Scene) -> Iterator[Measured]:
    """Measure the root finders over a sweep of each ring, against every root found for itself.

    Args:
        scene: What is swept.

    Raises:
        MechanicsError: There is no equilibrium to find.
    """
    forward = 1.0 if scene.path.to_m > scene.path.from_m else -1.0  # the gel is the same from both sides
    stage_m = forward * np.linspace(scene.path.from_m, scene.path.to_m, _POSITIONS)
    joints = [Joint(_model(scene), scene.probe, ring_m, scene.path.indentation_m) for ring_m in scene.ring_m]
    truths = [_followed(joint, stage_m) for joint in joints]
    for one in methods("equilibrium"):
        finder: Callable[[Joint, Float64Array], Float64Array] = one.target
        cost_s = _position_s(finder, joints[-1], stage_m)
        error, words = 0.0, ""
        for joint, true in zip(joints, truths, strict=True):
            found = finder(joint, stage_m)
            off = np.abs(found - true)
            worst = float(np.max(off / np.abs(true))) if np.isfinite(off).all() else np.inf
            if worst > max(error, task("equilibrium").tolerance):
                degrees = f"{np.degrees(np.max(off)):.2g} degrees off" if np.isfinite(worst) else "no angle"
                words = f"{degrees} at r_a = {joint.ring_m * 1e3:g} mm"
            error = max(error, worst)
        against = "the stable one of all roots, followed along the path"
        yield Measured("equilibrium", one.name, "", cost_s, error, "angle", against, fails=words)


def _position_s(
    finder: Callable[[Joint, Float64Array], Float64Array], joint: Joint, stage_m: Float64Array
) -> float:
    """Return the CPU of a position of a sweep as long as a run's; of a short one if that takes too long."""
    each_s = cpu_s(partial(finder, joint, stage_m), rounds=2) / stage_m.size
    if each_s * _RUN_POSITIONS > _LONG_S * slowness():  # the same finders on every machine
        return each_s
    dense_m = np.linspace(stage_m[0], stage_m[-1], _RUN_POSITIONS)
    return cpu_s(partial(finder, joint, dense_m), rounds=2) / _RUN_POSITIONS


def _followed(joint: Joint, stage_m: Float64Array) -> Float64Array:
    """Return the angle along a sweep towards +Y: of all stable roots that which is followed."""
    solved = sweep(joint.model, joint.probe, joint.ring_m, joint.indentation_m, stage_m)
    every = equilibria(joint.model, joint.probe, joint.ring_m, joint.indentation_m, stage_m)
    angles = solved.angle_rad.copy()
    for i in range(len(stage_m)):
        stable = every.angle_rad[(every.position == i) & every.stable]
        if stable.size:
            angles[i] = stable[np.argmin(np.abs(stable - angles[i]))]
    return angles


@begins_after(0.9)
def measure_friction(scene: Scene) -> Iterator[Measured]:
    """Measure the laws of friction at several time steps, creeping from rest, against the implicit one.

    A ball that creeps or comes to rest is what tells laws apart; one that slides is the same to all.

    Args:
        scene: What is swept: its gel, its last ring, and its speed if that is slower than 0.5 mm/s.

    Raises:
        MechanicsError: There is no equilibrium to start from.
    """
    usual_s = Dynamics().step_s
    truth = _from_rest(scene, "coulomb_implicit", _FINE_S)
    against = f"the implicit law at {_FINE_S * 1e6:g} us, from rest at {_creep_m_s(scene) * 1e3:g} mm/s"
    for step_s in (usual_s, 5.0 * usual_s, usual_s / 5.0):
        for one in methods("friction"):
            cost_s = cpu_s(partial(one.target, _slip()), rounds=2)
            error, words = _law_error(scene, one.name, step_s, truth)
            setting, usual = f"step {step_s * 1e6:g} us", step_s == usual_s
            yield Measured(
                "friction", one.name, setting, cost_s, error, "torque", against, usual=usual, fails=words
            )


def _law_error(scene: Scene, law: str, step_s: float, truth: DynamicSweep) -> tuple[float, str]:
    """Return the error of the torque over its largest value, and why the law is not to be trusted."""
    try:
        moved = _from_rest(scene, law, step_s)
    except MechanicsError as problem:
        return np.nan, str(problem)
    true = np.interp(moved.time_s, truth.time_s, truth.torque_n_m[0])
    error = float(np.max(np.abs(moved.torque_n_m[0] - true)) / np.max(np.abs(true)))
    late = moved.slip_m_s[0, moved.time_s.size // 2 :]
    jump = float(np.max(np.abs(np.diff(late)))) / _creep_m_s(scene)
    if jump > _CHATTER:
        return error, f"chatters: the slip changes by {jump:.2g} of the stage's speed in a step"
    return error, ""


def _creep_m_s(scene: Scene) -> float:
    return min(scene.path.speed_m_s, _CREEP_M_S)


def _from_rest(scene: Scene, law: str, step_s: float) -> DynamicSweep:
    start_m, speed_m_s = scene.path.from_m, _creep_m_s(scene)
    end_m = start_m + float(np.copysign(speed_m_s * _REST_S, scene.path.to_m - start_m))
    return simulate(
        _model(scene), scene.probe, scene.ring_m[-1], scene.path.indentation_m, start_m, end_m, speed_m_s,
        Dynamics(step_s=step_s), find("friction", law).target, at_rest=True, guard=False,
    )  # fmt: skip


def _slip() -> Slip:
    one = np.ones(1)
    return Slip(one, 0.3, 0.3, 0.0 * one, 0.02, 0.07 * one, 0.1 * one, 0.2 * one, one, 1e-3)


@begins_after(1.0)
def measure_motion(scene: Scene) -> Iterator[Measured]:
    """Measure the joint at rest and in motion, at the scene's own speed first, then at faster ones.

    Each is held against the finest time step so far, in the end half the usual one.

    Args:
        scene: What is swept; ``contrast`` where it is asked for that, else ``peak``.

    Raises:
        MechanicsError: There is no equilibrium to start from.
    """
    own_m_s = scene.path.speed_m_s
    yield from _at_speed(scene, own_m_s, "", (10.0, 2.0, 1.0, 0.5))
    for speed_m_s in sorted({*_FAST_M_S} - {own_m_s}, reverse=True):  # the fastest takes least
        yield from _at_speed(scene, speed_m_s, f"at {speed_m_s * 1e3:g} mm/s", (10.0, 1.0, 0.5))


def _at_speed(scene: Scene, speed_m_s: float, condition: str, steps: Sequence[float]) -> Iterator[Measured]:
    """Measure at a speed with ever finer time steps, in usual ones; the last is only held against."""
    output, usual_s = motion_output(scene.tolerance.output), Dynamics().step_s
    asked = replace(scene, path=replace(scene.path, speed_m_s=speed_m_s))
    found = [("quasi_static", "", *_timed(asked, output, None))]
    for longer in steps:
        cost_s, truth = _timed(asked, output, longer * usual_s)
        step = f"step {longer * usual_s * 1e6:g} us"
        for name, setting, own_s, values in found:
            error = float(np.max(np.abs(values / truth - 1.0)))
            words = ""
            if name == "quasi_static" and error > scene.tolerance.relative and longer <= 1.0:
                words = f"inertia moves the {output} by {error:.1%} at {speed_m_s * 1e3:g} mm/s"
            usual = setting in ("", f"step {usual_s * 1e6:g} us")
            yield Measured(
                "motion", name, setting, own_s, error, output, f"dynamic, {step}",
                usual=usual, condition=condition, fails=words,
            )  # fmt: skip
        found.append(("dynamic", step, cost_s, truth))


def _timed(scene: Scene, output: str, step_s: float | None) -> tuple[float, Float64Array]:
    """Return CPU of a sweep and the output by ring: quasi-static, or stepped in time."""
    path, of = scene.path, contrast_n_m if output == "contrast" else peak_n_m
    stage_m = path.stage_m()
    model, solved = _model(scene), list[Sweep]()

    def run() -> None:
        if step_s is None:
            still = [sweep(model, scene.probe, r, path.indentation_m, stage_m) for r in scene.ring_m]
            solved[:] = still
        else:
            setting = Dynamics(step_s=step_s)
            solved[:] = dynamic_sweeps(model, scene.probe, scene.ring_m, path, stage_m, setting)

    cost_s = cpu_s(run, rounds=1) / len(scene.ring_m)
    return cost_s, np.array([of(one) for one in solved])
