import numpy as np
import pytest

from palp_core.errors import MethodError, PerceptionError
from palp_core.palpation.perception.signal.smoothers import (
    SMOOTHERS,
    LowPass,
    SavitzkyGolay,
    Smoother,
    smoother,
)


def bump(count: int = 3000) -> np.ndarray:
    t = np.arange(count)
    return np.asarray(0.02 + 0.01 * np.exp(-0.5 * ((t - count / 2) / 150.0) ** 2))


def test_an_unknown_smoother_is_refused_with_those_there_are() -> None:
    with pytest.raises(MethodError, match=", ".join(SMOOTHERS)):
        smoother("median")


@pytest.mark.parametrize("name", SMOOTHERS)
def test_the_bump_stays_in_its_place_and_noise_shrinks(name: str) -> None:
    one, clean = smoother(name), bump()
    noise = np.random.default_rng(1).normal(0.0, 5e-4, clean.size)
    inner = slice(max(one.edge, 1), -max(one.edge, 1))
    quiet = one.apply(clean)[inner] - clean[inner]
    left = one.apply(clean + noise)[inner] - clean[inner]
    assert np.abs(quiet).max() < 1e-4
    assert left.std() < (1.01 if name == "none" else 0.35) * 5e-4
    assert abs(int(np.argmax(one.apply(clean))) - clean.size // 2) <= 2


@pytest.mark.parametrize("name", [name for name in SMOOTHERS if name != "db10_soft"])
def test_no_sample_depends_on_what_comes_later_than_the_lag(name: str) -> None:
    """The soft rule does: its threshold is the whole sweep's."""
    one, signal = smoother(name), bump()
    changed = signal.copy()
    changed[2000:] += 1.0
    last = 2000 - one.lag
    assert one.apply(changed)[:last] == pytest.approx(one.apply(signal)[:last], abs=1e-9)


@pytest.mark.parametrize("one", [LowPass(0.02, 2), LowPass(0.01, 4), SavitzkyGolay(30, 2)])
def test_a_ramp_passes_unchanged_beyond_the_edge(one: Smoother) -> None:
    ramp = np.linspace(0.0, 3.0, 3000)
    inner = slice(one.edge, -max(one.edge, 1))
    assert one.apply(ramp)[inner] == pytest.approx(ramp[inner], abs=6e-4)


def test_what_cannot_be_smoothed_says_why() -> None:
    for name in ("none", "low_pass", "savitzky_golay"):
        with pytest.raises(PerceptionError, match="finite"):
            smoother(name).apply(np.full(3000, np.nan))
    with pytest.raises(PerceptionError, match="101"):
        SavitzkyGolay().apply(np.ones(50))
    with pytest.raises(PerceptionError, match="cut-off"):
        LowPass(0.5)
