"""Several phantoms per depth: a condition of the simulated sessions, off unless it is asked for."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import SimulatedSession, begin_session
from palp_core.palpation.studies.simulation.reading_table import Gel, ReadingTable, tabulate

EXACT = Conditions(repeatability_m=0.0, height_sd_m=0.0, trials=4, training=4)
POURED = replace(EXACT, phantoms=2, specimen_sd_m=0.2e-3)


@pytest.fixture(scope="module")
def felt() -> ReadingTable:
    return tabulate(Gel(depths_m=(0.002, 0.004), rings_m=(0.008, 0.016)), noisy_sweeps=2)


def heights_m(session: SimulatedSession) -> np.ndarray:
    """Heights of the trials' surfaces, shape (depths, trials)."""
    return session.draws.height_m.reshape(2, -1)


def test_one_phantom_per_depth_is_the_default_and_its_own_offset_is_learnt_with_it(
    felt: ReadingTable,
) -> None:
    assert Conditions().phantoms == 1
    assert Conditions().specimen_sd_m == 0.0
    one = begin_session(felt, replace(EXACT, specimen_sd_m=0.2e-3), (1, 2))
    assert np.ptp(heights_m(one), axis=1).max() == 0.0
    assert one.latent.offset_sd[1] == 0.0  # in the model of what stays, a trial's phantom is the training's


def test_phantoms_take_turns_in_training_and_are_the_same_in_estimation(felt: ReadingTable) -> None:
    session = begin_session(felt, POURED, (1, 2))
    met = heights_m(session)
    assert np.array_equal(met[:, 0], met[:, 2])
    assert np.array_equal(met[:, 1], met[:, 3])
    assert (met[:, 0] != met[:, 1]).all()
    learnt = session.trained.readings
    rises = felt.height_slope() * (met[:, 1] - met[:, 0])[:, None]
    assert learnt[..., 1::2].mean(axis=-1) - learnt[..., ::2].mean(axis=-1) == pytest.approx(
        rises, rel=0.1, abs=6.0 * felt.noise_sd.max()
    )
    assert session.latent.offset_sd[1] == pytest.approx(0.2e-3 / np.sqrt(2.0))


def test_trials_of_other_phantoms_share_none_with_training(felt: ReadingTable) -> None:
    same, other = (begin_session(felt, replace(POURED, specimens=one), (1, 2)) for one in ("same", "other"))
    assert np.array_equal(same.trained.readings, other.trained.readings)
    assert not set(heights_m(same).ravel()) & set(heights_m(other).ravel())
    assert other.latent.offset_sd[1] == pytest.approx(0.2e-3 * np.sqrt(1.5))


def test_a_mounting_is_one_phantoms(felt: ReadingTable) -> None:
    met = heights_m(begin_session(felt, replace(EXACT, phantoms=2, height_sd_m=0.1e-3), (3, 4)))
    assert np.array_equal(met[:, :2], met[:, 2:])
    assert (met[:, 0] != met[:, 1]).all()


def test_phantoms_do_not_touch_the_rest_of_a_sessions_luck(felt: ReadingTable) -> None:
    usual, poured = (begin_session(felt, one, (5, 6)).draws for one in (EXACT, POURED))
    assert np.array_equal(usual.noise, poured.noise)
    assert np.array_equal(usual.uniforms, poured.uniforms)
    again = begin_session(felt, POURED, (5, 6)).draws
    assert np.array_equal(again.height_m, poured.height_m)


@pytest.mark.parametrize("count", [0, 5])
def test_phantoms_that_nobody_touches_are_refused(count: int) -> None:
    with pytest.raises(PalpError, match="phantoms per depth"):
        replace(EXACT, phantoms=count)
