import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.levels import to_levels


def test_values_outside_the_scale_are_clamped_and_counted() -> None:
    found = to_levels(np.array([0.0, 0.04, 0.06, 0.3, 0.54, 0.56, 1.7]))
    assert found.index.tolist() == [0, 0, 0, 2, 4, 4, 4]
    assert (found.clamped_low_count, found.clamped_high_count) == (2, 2)


def test_nan_has_no_level() -> None:
    with pytest.raises(PerceptionError, match="NaN"):
        to_levels(np.array([np.nan]))


@settings(deadline=None, max_examples=50)
@given(st.floats(-1.0, 2.0))
def test_the_level_is_the_nearest(value: float) -> None:
    levels = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    index = int(to_levels(np.array([value])).index[0])
    assert abs(levels[index] - value) <= np.abs(levels - value).min() + 1e-12
