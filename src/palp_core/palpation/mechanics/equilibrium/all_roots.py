"""Every equilibrium of the joint at given stage positions, stable or not, lagging or leading."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.joint import joint_at
from palp_core.palpation.mechanics.equilibrium.roots import bracketed_newton
from palp_core.palpation.mechanics.probe import Probe
from palp_core.units import Float64Array

_ANGLES = 257


@dataclass(frozen=True, eq=False)
class Equilibria:
    """All roots, one entry per root, sorted by position as given and then by angle.

    >>> from palp_core.palpation import Bead, Phantom, Probe, contact_model, equilibria
    >>> model, _ = contact_model(Phantom(bead=Bead(depth_m=0.004)), Probe().tip_radius_m)
    >>> found = equilibria(model, Probe(), 0.008, 0.004, [0.0, 0.01], leading=False)
    >>> found.position.tolist(), found.stable.tolist()
    ([0, 1], [True, True])
    """

    position: NDArray[np.int64]  # Index into the stage positions asked for
    stage_m: Float64Array  # Stage position Y
    angle_rad: Float64Array  # Joint angle q; negative where the tip leads
    torque_n_m: Float64Array  # Torque of the sensor
    stable: NDArray[np.bool_]  # Whether a small turn is pushed back


def equilibria(
    model: ContactModel,
    probe: Probe,
    ring_m: float,
    indentation_m: float,
    stage_m: ArrayLike,
    *,
    leading: bool = True,
) -> Equilibria:
    """Return all equilibria between lift-off on either side for a sweep towards +Y.

    Roots are separated where one of 257 angles per side lies between them, a tenth of a millimetre of the
    tip.

    Args:
        model: Contact forces over the phantom.
        probe: Dimensions of the probe.
        ring_m: True position r_a of the anchor ring.
        indentation_m: Nominal indentation delta0, positive.
        stage_m: Stage positions, shape (n,), in any order.
        leading: Whether to look for a leading tip, q < 0, too.

    Raises:
        OutOfRange: An input lies outside the model's or the joint's range, or there is no contact to balance.
        MechanicsError: The contact force is not a number somewhere.
    """
    positions = np.atleast_1d(np.asarray(stage_m, dtype=np.float64))
    if positions.ndim != 1 or not np.isfinite(positions).all():
        raise OutOfRange("stage_m", "positions must be a row of finite numbers")
    joint = joint_at(model, probe, ring_m, indentation_m)
    if joint.restoring_n_m == 0.0 or indentation_m <= 0.0:
        raise OutOfRange(
            "indentation_m", "the tip is in the air at every angle; press, or give the joint a spring"
        )
    limit = joint.lift_off_rad
    grid = np.linspace(-limit if leading else 0.0, limit, 2 * _ANGLES - 1 if leading else _ANGLES)
    residual = joint.residual(positions[:, None], grid)
    if not np.isfinite(residual).all():
        raise MechanicsError("the contact force is not a number somewhere between the sides' lift-off")
    back = residual >= 0.0
    position, cell = np.nonzero(back[:, 1:] != back[:, :-1])
    stable = back[position, cell + 1]
    sign = np.where(stable, 1.0, -1.0)
    at_m = positions[position]
    angle_rad = bracketed_newton(lambda q: sign * joint.residual(at_m, q), grid[cell], grid[cell + 1])
    normal_n, lateral_n = joint.contact(at_m, angle_rad)
    torque_n_m = joint.torque(angle_rad, normal_n, lateral_n)
    return Equilibria(position, at_m, angle_rad, torque_n_m, stable)
