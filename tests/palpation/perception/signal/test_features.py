import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.signal.features import contrast, peak
from palp_core.palpation.perception.signal.wavelet import edge_cone


def _sweep(base: float = 0.02, rise: float = 0.01, centre: int = 2000) -> np.ndarray:
    return base + rise * np.exp(-0.5 * ((np.arange(4000) - centre) / 150.0) ** 2)


def test_the_peak_is_over_the_nodule() -> None:
    found = peak(_sweep(), edge=edge_cone())
    assert found.index == 2000
    assert found.value_n_m == pytest.approx(0.03)


def test_no_peak_comes_from_inside_the_edge_cone() -> None:
    torque = _sweep()
    torque[:50], torque[-50:] = 9.0, 9.0
    assert int(np.argmax(torque)) == 0
    assert peak(torque, edge=edge_cone()).index == 2000


def test_a_window_limits_the_search() -> None:
    torque = _sweep()
    torque[1000] = 9.0
    assert peak(torque, edge=edge_cone(), around=(1500, 2500)).index == 2000


def test_nothing_left_to_search_is_an_error() -> None:
    with pytest.raises(PerceptionError, match="sweep further"):
        peak(np.ones(1000), edge=589)
    with pytest.raises(PerceptionError, match="sweep further"):
        peak(np.ones(4000), edge=589, around=(0, 500))


def test_contrast_ignores_the_base_that_the_peak_includes() -> None:
    low, high = _sweep(base=0.0), _sweep(base=0.05)
    assert contrast(low, edge=589).value_n_m == pytest.approx(0.01, rel=1e-2)
    assert contrast(high, edge=589).value_n_m == pytest.approx(contrast(low, edge=589).value_n_m, abs=1e-12)
    assert peak(high, edge=589).value_n_m == pytest.approx(peak(low, edge=589).value_n_m + 0.05, rel=1e-3)


def test_a_flank_inside_the_boundary_is_left_out() -> None:
    torque = _sweep(centre=1000)
    torque[:589] = 9.0
    assert contrast(torque, edge=589).value_n_m == pytest.approx(0.01, rel=1e-2)
    with pytest.raises(PerceptionError, match="flank"):
        contrast(torque, edge=589, reach=3500)


@settings(deadline=None, max_examples=20)
@given(st.floats(1e-3, 1e3), st.integers(-800, 800))
def test_features_scale_and_move_with_the_sweep(scale: float, shift: int) -> None:
    moved = scale * _sweep(centre=2000 + shift)
    assert peak(moved, edge=589).index == 2000 + shift
    assert contrast(moved, edge=589).value_n_m == pytest.approx(
        scale * contrast(_sweep(), edge=589).value_n_m, rel=0.01
    )
