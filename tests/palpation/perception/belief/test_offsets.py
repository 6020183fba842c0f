import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.offsets import ring_slopes

RINGS_M = np.array([0.0, 0.004, 0.008, 0.012, 0.016])


def test_slopes_of_a_straight_line_are_its_slope() -> None:
    assert ring_slopes(1.5 * RINGS_M[None], RINGS_M) == pytest.approx(np.full((1, 5), 1.5))


def test_one_ring_position_has_no_slope() -> None:
    with pytest.raises(PerceptionError, match="needs two"):
        ring_slopes(np.zeros((3, 1)), RINGS_M[:1])
