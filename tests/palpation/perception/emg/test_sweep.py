import numpy as np

from palp_core.palpation.perception.emg.analysis import EmgSettings
from palp_core.palpation.perception.emg.sweep import sweep


def test_higher_thresholds_and_deeper_valleys_find_less() -> None:
    rng = np.random.default_rng(0)
    strength = 0.02 + 0.4 * np.sin(np.arange(15_000) / 400.0) ** 2
    trial, mvc = strength * rng.normal(size=(2, 15_000)), rng.normal(size=(2, 6000))
    rows = sweep([(trial, mvc)], EmgSettings(), windows_s=(0.05, 0.15), valley_shares=(0.5, 0.6, 0.85))
    bursts = {(row.window_s, row.on_share, row.valley_share): row.burst_count for row in rows}
    peaks = {(row.window_s, row.on_share, row.valley_share): row.peak_count for row in rows}
    assert len(rows) == 2 * 3 * 3
    for window_s in (0.05, 0.15):
        assert peaks[window_s, 0.05, 0.5] <= peaks[window_s, 0.05, 0.6] <= peaks[window_s, 0.05, 0.85]
        assert bursts[window_s, 0.05, 0.5] == bursts[window_s, 0.05, 0.85]  # a valley ends no burst
    assert peaks[0.05, 0.05, 0.85] > peaks[0.15, 0.05, 0.85]  # a short window's scatter counts as peaks
    assert all(row.transition_count == row.peak_count - 1 for row in rows)
    assert all(0.0 <= row.lambda_2 < 1.0 for row in rows)
