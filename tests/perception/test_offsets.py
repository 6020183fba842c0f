import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.perception import latent
from palp_core.perception.offsets import landing_model, ring_slopes

RINGS_M = np.array([0.0, 0.004, 0.008, 0.012, 0.016])


@given(st.integers(0, 1000), st.floats(0.0, 1e-3))
@settings(max_examples=30, deadline=None)
def test_a_single_reading_spreads_as_it_did_in_training(seed: int, ring_sd_m: float) -> None:
    rng = np.random.default_rng(seed)
    mean, sd = np.sort(rng.normal(0, 5e-3, (3, 5)), axis=1), rng.uniform(1e-5, 1e-3, (3, 5))
    model = landing_model(mean, sd, RINGS_M, ring_sd_m)
    for k in range(5):
        centre, spread = latent.predict(model, latent.start(model), k)
        assert centre[:, 0] == pytest.approx(mean[:, k])
        assert np.sqrt(spread[:, 0, 0]) == pytest.approx(sd[:, k])


def test_slopes_of_a_straight_line_are_its_slope() -> None:
    assert ring_slopes(1.5 * RINGS_M[None], RINGS_M) == pytest.approx(np.full((1, 5), 1.5))


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(PerceptionError, match="needs two"):
        ring_slopes(np.zeros((3, 1)), RINGS_M[:1])
    with pytest.raises(PerceptionError, match="0 or more"):
        landing_model(np.zeros((3, 5)), np.ones((3, 5)), RINGS_M, -1.0)
