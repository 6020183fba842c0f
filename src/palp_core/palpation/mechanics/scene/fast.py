"""Sweeps that are too fast to leave inertia out, read at the stage positions of a quasi-static one."""

from collections.abc import Sequence

import numpy as np

from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, simulate
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import StagePath
from palp_core.units import Float64Array


def dynamic_sweeps(
    model: ContactModel,
    probe: Probe,
    ring_m: Sequence[float],
    path: StagePath,
    stage_m: Float64Array,
    dynamics: Dynamics | None = None,
) -> tuple[Sweep, ...]:
    """Return one sweep per ring position, the joint's inertia and implicit friction included.

    Between time steps angle, torque and normal force are read off linearly; contact and place follow from the
    angle.

    Args:
        model: Contact forces over the phantom.
        probe: Dimensions of the probe.
        ring_m: Ring positions.
        path: The way of the stage, its speed and indentation.
        stage_m: Where to read, in sweep order, shape (n,).
        dynamics: Inertia, damping, step; None: the usual ones.

    Raises:
        MechanicsError: No equilibrium to start from.
        OutOfRange: The speed asks for more than five million steps.
    """
    moved = simulate(
        model, probe, ring_m, path.indentation_m, path.from_m, path.to_m, path.speed_m_s, dynamics
    )
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
                guards=moved.guards,
            )
        )
    return tuple(made)
