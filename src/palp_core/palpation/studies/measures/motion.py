"""Task ``motion``, measured in a scene.

The contact below is L2 throughout: how well a joint is solved does not depend on whose forces it is solved
with, and L2's cost nothing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from palp_core.methods.measured import Measured, cpu_s
from palp_core.palpation.mechanics import LayeredHertz, Scene, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.scene.output import contrast_n_m, peak_n_m
from palp_core.palpation.mechanics.scene.run import dynamic_sweeps
from palp_core.palpation.mechanics.scene.scene import motion_output
from palp_core.units import Float64Array

_FAST_M_S = (0.05, 0.2)


def _model(scene: Scene) -> LayeredHertz:
    return LayeredHertz(scene.phantoms[0], scene.probe.tip_radius_m)


def measure_motion(scene: Scene) -> Iterator[Measured]:
    """Measure the joint at rest and in motion, at the scene's own speed first, then at faster ones.

    Each is held against the finest time step so far, in the end half the usual one.
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
