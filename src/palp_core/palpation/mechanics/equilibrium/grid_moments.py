"""What the contact does on a grid of positions and angles: computed once for all rings at one height."""

from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.probe import Probe
from palp_core.units import Float64Array

_MOST = 8  # grids of one mounting and direction: before and after refinement, and where several roots are


class GridMoments:
    """Remembers the contact's moment on the latest grids; what is asked again is not computed again.

    The ring changes only what spring and weight bring, and a mounting sees hundreds of rings.
    """

    def __init__(self) -> None:
        self._kept: dict[
            tuple[int, Probe, float, float, bytes], tuple[ContactModel, Float64Array, Float64Array]
        ] = {}

    def residual(self, joint: Joint, forward_m: Float64Array, grid_rad: Float64Array) -> Float64Array:
        """Return :meth:`.Joint.residual` at every position and angle, shape (positions, angles).

        Args:
            joint: At its ring.
            forward_m: Positions along the sweep, shape (positions,).
            grid_rad: Angles, shape (angles,); they follow from model, probe and indentation.
        """
        key = (id(joint.model), joint.probe, joint.indentation_m, joint.direction, forward_m.tobytes())
        if (found := self._kept.get(key)) is None:
            sine, pushing, _, _ = joint.contact_moment(forward_m[:, None], grid_rad)
            if len(self._kept) == _MOST:
                del self._kept[next(iter(self._kept))]
            found = self._kept[key] = joint.model, sine, pushing  # the model kept: its id is nobody else's
        _, sine, pushing = found
        return joint.restoring_n_m * sine - pushing
