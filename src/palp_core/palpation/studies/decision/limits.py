"""The limits to draw beside decisions: what no policy can pass, and what the best one reaches."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.strategy.optimal import Optimum, chernoff_information, optimum
from palp_core.palpation.perception.strategy.optimal_shared import (
    fano_accuracy,
    probe_capacity_bits,
    shared_optimum,
    wald_probes,
)
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.reading_table import ReadingTable
from palp_core.units import Float64Array

COSTS = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_SEED = 22


@dataclass(frozen=True)
class Limits:
    """Limits on accuracy against probes, for a rig as it truly is.

    Attributes:
        independent: Dynamic programming if every reading had errors of its own, a pair per price.
        chernoff_nats: The asymptotic rate of such readings, nats a probe.
        shared: The numerical optimum of the model with errors that stay.
        capacity_bits: The most that one reading can tell.
        fano: Pairs of probes and the accuracy that Fano permits to so much information.
        wald: Pairs of probes and accuracy: Wald's bound for the two depths, at the best ring, that are
            hardest to tell apart.
        wald_for: Those depths and that ring, mm.
    """

    independent: tuple[Optimum, ...]
    chernoff_nats: float
    shared: tuple[Optimum, ...]
    capacity_bits: float
    fano: tuple[tuple[float, float], ...]
    wald: tuple[tuple[float, float], ...]
    wald_for: tuple[float, float, float]

    def to_json_dict(self) -> dict[str, Any]:
        """Return plain numbers."""
        return asdict(self)


def what_stays(felt: ReadingTable, conditions: Conditions) -> OffsetModel:
    """Return readings as they truly are: the landing stays until the ring moves, the height for the trial.

    Args:
        felt: What is felt.
        conditions: How much both vary; a landing counts as normal, a height against that of training.
    """
    return OffsetModel(
        felt.nominal()[..., None],
        felt.noise_sd[..., None, None] ** 2,
        np.stack([felt.ring_slope(), felt.height_slope()], axis=-1)[:, :, None, :],
        np.array([conditions.ring_sd_m, np.sqrt(2.0) * conditions.height_sd_m]),
        (True, False),
    )


def limits(felt: ReadingTable, conditions: Conditions, trial_count: int = 4000) -> Limits:
    """Return the limits for a touch and a rig.

    Args:
        felt: What is felt.
        conditions: How much landing and height vary; a landing counts as normal.
        trial_count: Trials by which the optimum with shared errors is found.
    """
    mean, m = felt.nominal(), len(felt.gel.depths_m)
    ring, height = felt.ring_slope(), felt.height_slope()
    height_sd_m = np.sqrt(2.0) * conditions.height_sd_m
    sd = np.sqrt(
        felt.noise_sd**2 + (ring * conditions.ring_sd_m) ** 2 + (height * height_sd_m) ** 2
    )  # of a single reading
    capacity = probe_capacity_bits(mean, sd)
    first, second, best = _hardest(mean, sd)
    pair = (mean[[first, second], best], sd[[first, second], best])
    shares = (0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999)
    depths_m = felt.gel.depths_m
    return Limits(
        tuple(optimum(mean, sd, COSTS)),
        chernoff_information(mean, sd),
        tuple(
            shared_optimum(
                what_stays(felt, conditions), COSTS, np.random.default_rng(_SEED), trial_count=trial_count
            )
        ),
        capacity,
        tuple((float(n), fano_accuracy(n * capacity, m)) for n in np.linspace(0.0, 2.0, 21)),
        tuple((wald_probes(*pair, share), share) for share in shares),
        (1e3 * depths_m[first], 1e3 * depths_m[second], 1e3 * felt.gel.rings_m[best]),
    )


def _hardest(mean: Float64Array, sd: Float64Array) -> tuple[int, int, int]:
    """Return the two classes that are hardest to tell apart at the ring where they are easiest to."""
    pairs = [(i, j) for i in range(len(mean)) for j in range(i + 1, len(mean))]
    apart = np.array([np.abs(mean[i] - mean[j]) / np.sqrt(0.5 * (sd[i] ** 2 + sd[j] ** 2)) for i, j in pairs])
    row = int(np.argmin(apart.max(axis=1)))
    return (*pairs[row], int(np.argmax(apart[row])))


def least_seconds(probes: float, timing: Timing | None = None, ring_m: float = 0.016) -> float:
    """Return the least time that so many probes take on the rig, each landed on anew at the stiff end.

    The first ring is reached from the stop, every other by the shortest move there is, 4 mm.

    Args:
        probes: Expected number, 1 or more.
        timing: How long moves and sweeps take.
        ring_m: Where the first probe is.
    """
    spent = timing or Timing()
    first = (ring_m + spent.home_m) / spent.ring_m_per_s + spent.settle_s
    between = float(spent.move_s(np.array(0.0), np.array(0.004)))
    return first + probes * spent.sweep_s + max(probes - 1.0, 0.0) * between
