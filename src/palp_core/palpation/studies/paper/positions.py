"""What each ring position tells of the depth beside what scatters there, and how often people are at it."""

from typing import Any

import numpy as np

from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.reading_table import ReadingTable


def positions(felt: ReadingTable, conditions: Conditions) -> list[dict[str, float]]:
    """Return a line per ring position.

    Args:
        felt: What is felt, at the paper's ring positions.
        conditions: How far landings and heights scatter.

    Returns:
        ``ring_mm``; ``gap_n_mm``, the least between neighbouring depths' readings; ``landing_n_mm`` and
        ``height_n_mm``, standard deviations of a reading by either, mean over depths; ``human``, the share of
        palpations that the reconstructed human strategy makes there in the long run.
    """
    gap = np.abs(np.diff(felt.nominal(), axis=0)).min(axis=0)
    landing = np.abs(felt.ring_slope()).mean(axis=0) * conditions.ring_sd_m
    height = np.abs(felt.height_slope()).mean(axis=0) * conditions.height_sd_m
    there = markov.stationary(np.mean(figure5.matrices(), axis=0))
    columns: dict[str, Any] = {
        "ring_mm": 1e3 * np.asarray(felt.gel.rings_m),
        "gap_n_mm": 1e3 * gap,
        "landing_n_mm": 1e3 * landing,
        "height_n_mm": 1e3 * height,
        "human": there,
    }
    return [dict(zip(columns, map(float, line), strict=True)) for line in zip(*columns.values(), strict=True)]
