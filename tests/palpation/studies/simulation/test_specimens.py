"""Several phantoms per depth: a condition of the simulated sessions, off unless it is asked for."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import SimulatedSession, begin_session
from palp_core.palpation.studies.simulation.reading_table import Gel, ReadingTable, tabulate

EXACT = Conditions(repeatability_m=0.0, height_sd_m=0.0, trials=4, training=4)


@pytest.fixture(scope="module")
def felt() -> ReadingTable:
    return tabulate(Gel(depths_m=(0.002, 0.004), rings_m=(0.008, 0.016)), noisy_sweeps=2)


def heights_m(session: SimulatedSession) -> np.ndarray:
    """Heights of the trials' surfaces, shape (depths, trials)."""
    return session.draws.height_m.reshape(2, -1)


def test_a_mounting_is_one_phantoms(felt: ReadingTable) -> None:
    met = heights_m(begin_session(felt, replace(EXACT, phantoms=2, height_sd_m=0.1e-3), (3, 4)))
    assert np.array_equal(met[:, :2], met[:, 2:])
    assert (met[:, 0] != met[:, 1]).all()


@pytest.mark.parametrize("count", [0, 5])
def test_phantoms_that_nobody_touches_are_refused(count: int) -> None:
    with pytest.raises(PalpError, match="phantoms per depth"):
        replace(EXACT, phantoms=count)
