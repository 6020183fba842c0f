"""What benchmarks/view.py computes from its measurements."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.view import ages


def test_a_sample_is_as_old_as_the_first_frame_that_shows_it() -> None:
    found = ages(np.array([1.0, 2.0, 2.5]), np.array([0.9, 1.9, 1.9]))
    assert len(found) == 1000  # each once: the last frame has no new one
    assert (found.min(), found.max()) == pytest.approx((0.1, 1.099))
