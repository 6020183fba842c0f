"""What differs between mounts."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.sim.mount import ALWAYS_THE_SAME, BY_HAND, Mounting, MountVariation


def test_a_phantom_that_never_differs_stays_where_it_is() -> None:
    assert ALWAYS_THE_SAME.draw(np.random.default_rng(0)) == Mounting(0.0, 0.0)


def test_mounts_spread_as_stated() -> None:
    rng = np.random.default_rng(0)
    mounts = [BY_HAND.draw(rng) for _ in range(4000)]
    assert np.std([m.height_m for m in mounts]) == pytest.approx(BY_HAND.height_sd_m, rel=0.05)
    assert np.std([m.tilt_rad for m in mounts]) == pytest.approx(BY_HAND.tilt_sd_rad, rel=0.05)


def test_the_spread_of_one_does_not_change_the_draw_of_the_other() -> None:
    flat, tilted = (MountVariation(1e-4, tilt).draw(np.random.default_rng(5)) for tilt in (0.0, 1e-2))
    assert flat.height_m == tilted.height_m


def test_a_negative_spread_is_refused() -> None:
    with pytest.raises(DeviceError, match="height_sd_m"):
        MountVariation(height_sd_m=-1e-4)
