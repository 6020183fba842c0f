"""The searcher's parameters are the search's own, in the units in which a person types them."""

import pytest

from palp_core.palpation.perception.search.settings import SearchSettings
from palp_core.palpation.session.search_settings import SearchParams


def test_parameters_are_the_settings_in_other_units() -> None:
    usual, own = SearchSettings(), SearchParams().settings()
    for name, value in vars(usual).items():
        assert vars(own)[name] == pytest.approx(value), name
    changed = SearchParams(rings_mm=[8.0, 16.0], speed_mm_s=40.0, texture_sd_n_mm=0.5).settings()
    assert changed.rings_m == pytest.approx((0.008, 0.016))
    assert (changed.speed_m_s, changed.texture_sd_n_m) == pytest.approx((0.04, 0.5e-3))
