"""What benchmarks/view.py makes of what it has measured."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.view_bench.running import spread
from benchmarks.view_bench.screen import ages


def test_a_sample_is_as_old_as_the_first_frame_that_shows_it() -> None:
    found = ages(np.array([1.0, 2.0, 2.5]), np.array([0.9, 1.9, 1.9]))
    assert len(found) == 1000  # each once: the last frame has no new one
    assert (found.min(), found.max()) == pytest.approx((0.1, 1.099))


def test_a_number_has_its_median_and_its_ends() -> None:
    assert spread([3.0, 1.0, 2.04], 1) == {"median": 2.0, "min": 1.0, "max": 3.0, "n": 3}
