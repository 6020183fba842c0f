import numpy as np

from palp_core.palpation.perception.emg.analysis import EmgSettings
from palp_core.palpation.perception.emg.sweep import sweep


def test_a_longer_distance_and_a_larger_prominence_find_fewer_bursts() -> None:
    rng = np.random.default_rng(0)
    strength = 0.1 + 0.4 * np.sin(np.arange(15_000) / 400.0) ** 2
    trial, mvc = strength * rng.normal(size=(2, 15_000)), rng.normal(size=(2, 6000))
    rows = sweep([(trial, mvc)], EmgSettings(), windows_s=(0.05, 0.15))
    count = {(row.window_s, row.prominence, row.distance_s): row.burst_count for row in rows}
    assert len(rows) == 2 * 3 * 3
    for window_s in (0.05, 0.15):
        assert count[window_s, 0.025, 0.1] >= count[window_s, 0.1, 0.1]
        assert count[window_s, 0.05, 0.1] >= count[window_s, 0.05, 0.4]
    assert count[0.05, 0.05, 0.1] > count[0.15, 0.05, 0.1]  # a short window's scatter counts as bursts
    assert all(row.transition_count == row.burst_count - 1 for row in rows)
    assert all(0.0 <= row.lambda_2 < 1.0 for row in rows)
