"""A belief on the map is the Gaussian likelihood of all lanes together, and follows from the lanes alone."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.search.belief import FIXED, SearchBelief, add_lane, believe, start
from palp_core.palpation.perception.search.samples import Likelihood
from palp_core.palpation.perception.search.searcher import Searcher
from palp_core.palpation.perception.search.settings import Lane, LaneRead
from palp_core.units import Float64Array
from tests.palpation.perception.search.made_up import SETTINGS, answers, bump, read_of

SEARCHER = Searcher(SETTINGS, [answers()])
LEVEL = SEARCHER.level_of(0.016, None)
BEAD = np.array([[0.003, -0.002, 0.0035]])
OFFSETS = np.array([0.2, -0.1, 0.3, 0.5, -0.8, 0.1])
LANES = (Lane(-0.006), Lane(0.000, forward=False), Lane(0.006), Lane(0.004, forward=False))


def reads(beads: Float64Array = BEAD) -> list[LaneRead]:
    return [read_of(LEVEL, lane, beads, OFFSETS, 5 + k) for k, lane in enumerate(LANES)]


def believed(of: list[LaneRead]) -> SearchBelief:
    return believe(SETTINGS, SEARCHER.level_of, of)


def dense(belief: SearchBelief, cell: tuple[int, int, int] | None) -> float:
    """Return the log density of all bins at once, given a bead in a cell (x, d, y), or none."""
    count, bins = FIXED + 1, SETTINGS.bins
    mean, columns, noise = [], [], []
    for one in belief.lanes:
        seen = np.zeros((4, bins))
        if cell is not None:
            x_m, y_m = SETTINGS.cells_m[cell[0]], SETTINGS.cells_m[cell[2]]
            beside_m = x_m - one.lane.x_m
            for b, stage_m in enumerate(SETTINGS.bins_m):
                u = round((stage_m - one.way * y_m - one.level.answers.past_m[0]) / SETTINGS.cell_m)
                seen[:, b] = one.level.columns[:, round(abs(beside_m) / 2e-3), cell[1], u]
            seen[1] *= np.sign(beside_m)
            seen[2] *= one.way
        scaled = np.concatenate([SETTINGS.amplitude_sd * seen[:1], seen[1:]])
        changes = one.columns(count)
        columns.append(np.concatenate([changes, scaled.T], axis=1))
        mean.append(one.rest_n_m(changes) - seen[0])
        lower = np.linalg.inv(one.level.white)
        noise.append(lower @ lower.T)
    together = np.concatenate(columns)
    spread = scipy.linalg.block_diag(*noise) + together @ together.T
    return float(scipy.stats.multivariate_normal(cov=spread).logpdf(np.concatenate(mean)))


@pytest.mark.parametrize("cell", [(7, 1, 5), (6, 0, 6), (0, 3, 12), (12, 2, 0)])
def test_sums_are_the_likelihood_of_all_bins_at_once(cell: tuple[int, int, int]) -> None:
    belief = believed(reads())
    prior = start(SETTINGS, SEARCHER.level_of).log_odds[cell]
    expected = dense(belief, cell) - dense(belief, None)
    assert belief.log_odds[cell] - prior == pytest.approx(expected, rel=1e-9, abs=1e-7)


def test_probabilities_add_up_and_point_to_the_bead() -> None:
    belief = believed(reads())
    assert belief.none + belief.cells.sum() == pytest.approx(1.0)
    assert belief.none < 1e-6
    i, j = np.unravel_index(int(np.argmax(belief.map)), belief.map.shape)
    assert SETTINGS.cells_m[i] == pytest.approx(BEAD[0, 0], abs=1.01e-3)
    assert SETTINGS.cells_m[j] == pytest.approx(BEAD[0, 1], abs=1.01e-3)


def test_the_order_of_lanes_does_not_matter() -> None:
    one, other = believed(reads()), believed(reads()[::-1])
    np.testing.assert_allclose(one.log_odds, other.log_odds, rtol=1e-9, atol=1e-7)


def test_lanes_over_bare_gel_make_no_bead_likelier() -> None:
    belief = start(SETTINGS, SEARCHER.level_of)
    before = belief.none
    for read in reads(np.zeros((0, 3))):
        belief = add_lane(belief, SEARCHER.level_of, read)
    assert belief.none > max(before, 0.9)


def test_the_level_is_the_one_that_the_base_shows() -> None:
    along = LEVEL.answers.direction * 2.1
    offsets = np.array([*along[:3], 0.0, 0.0, along[3]])
    belief = believe(SETTINGS, SEARCHER.level_of, [read_of(LEVEL, LANES[0], np.zeros((0, 3)), offsets, 3)])
    assert belief.lanes[0].level.offsets @ LEVEL.answers.direction == pytest.approx(2.0)


def test_a_signal_between_the_tables_nodes_is_the_one_that_is_tabulated() -> None:
    at = np.array([[0.0013, -0.0027, 0.0033], [0.0101, 0.0004, 0.0051]])
    read = LEVEL.signals.at(at[:, 0], at[:, 1], at[:, 2], SETTINGS.bins_m)[..., 0]
    exact = bump(at[:, :1], at[:, 2:], SETTINGS.bins_m - at[:, 1:2])
    np.testing.assert_allclose(read, exact, atol=0.01 * np.abs(exact).max())


def test_the_best_bead_explains_what_noise_leaves() -> None:
    belief = believed(reads())
    likelihood = Likelihood(belief.lanes, belief.offset_count)
    here, away = (likelihood.left(BEAD + move, BEAD[0])[0][0] for move in (0.0, 2e-3))
    assert here < away
    assert 0.5 < here / (len(LANES) * SETTINGS.bins) < 1.6


def test_a_lane_of_other_bins_is_refused() -> None:
    with pytest.raises(PerceptionError, match="give 20 bins"):
        believed([LaneRead(0.0, True, 0.016, [0.0] * 3)])
    with pytest.raises(PerceptionError, match="between the map's cells"):
        believed([LaneRead(0.001, True, 0.016, [0.02] * 20)])
