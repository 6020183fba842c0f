"""What every rung promises alike: shapes that broadcast, and no answer to an offset that is no number."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from palp_core.errors import OutOfRange
from palp_core.methods import names
from palp_core.palpation.mechanics import Bead, Phantom
from palp_core.palpation.mechanics.contact.l5 import FiniteStrainContact
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.units import Float64Array

RUNGS = sorted(names("contact"))
PHANTOMS = {"bead": Phantom(bead=Bead(depth_m=0.004)), "bare": Phantom()}


def coarse(phantom: Phantom) -> FiniteStrainContact:
    return FiniteStrainContact(phantom, 0.006, facet_m=0.0015)


@pytest.fixture(scope="module", params=RUNGS)
def models(request: pytest.FixtureRequest) -> dict[str, ContactModel]:
    """A rung over a bead and on bare gel, set up; L5 with the longest facets, in a fifth of the time."""
    made: dict[str, ContactModel] = {}
    for name, phantom in PHANTOMS.items():
        fine = request.param != "l5"
        made[name] = rung_model(request.param, phantom, 0.006) if fine else coarse(phantom)
        made[name].force(np.zeros(1), np.full(1, 0.001))
    return made


@pytest.mark.parametrize("phantom", PHANTOMS)
def test_an_offset_that_is_no_number_is_refused_by_name(
    models: dict[str, ContactModel], phantom: str
) -> None:
    model, pressed = models[phantom], np.full(2, 0.001)
    for answer, offset_m in product((model.force, model.energy), (math.nan, math.inf, -math.inf)):
        with pytest.raises(OutOfRange, match="an offset is not a number") as caught:
            answer(np.array([0.0, offset_m]), pressed)
        assert caught.value.quantity == "offset_m"


@pytest.mark.parametrize(
    ("offset_m", "indentation_m"),
    [
        (np.float64(0.004), np.float64(0.002)),
        (np.zeros(0), np.zeros(0)),
        (np.zeros((3, 1)), np.zeros((1, 0))),
        (np.array([[-0.004], [0.0], [0.004]]), np.array([-0.001, 0.001])),
    ],
    ids=("no dimension", "empty", "empty across", "grid"),
)
def test_forces_and_energy_have_the_broadcast_shape(
    models: dict[str, ContactModel], offset_m: Float64Array, indentation_m: Float64Array
) -> None:
    model = models["bead"]
    shape = np.broadcast_shapes(np.shape(offset_m), np.shape(indentation_m))
    parts = (*model.force(offset_m, indentation_m), model.energy(offset_m, indentation_m))
    assert [np.shape(part) for part in parts] == [shape] * 3
    assert all(np.isfinite(part).all() for part in parts)
