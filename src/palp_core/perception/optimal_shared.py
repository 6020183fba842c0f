"""What is possible when readings share errors, by numbers; and the limits of Wald and of Fano.

With errors that stay no recursion over the class belief is exact, for the offsets are part of the state. The
optimum is then found numerically within a family that holds all that shared errors leave to choose: which
settings, each landed on anew, and when to stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import brentq

from palp_core.errors import PerceptionError
from palp_core.perception import latent
from palp_core.perception.information import expected_gains_bits
from palp_core.perception.optimal import Optimum
from palp_core.units import Float64Array

__all__ = ["fano_accuracy", "probe_capacity_bits", "shared_optimum", "wald_probes"]

_FEW = 400  # trials per class that choose the settings


def wald_probes(mean: Float64Array, sd: Float64Array, accuracy: float) -> float:
    """Return the least expected number of probes of any test between two classes at one setting.

    The bound of Wald ("Sequential Analysis", 1947, app. A.7; attained by the sequential probability ratio
    test but for the overshoot): binary divergence of the accuracy over the divergence of a reading, the mean
    of both classes, readings independent.

    Args:
        mean: Mean reading of the two classes, shape (2,).
        sd: Standard deviation, shape (2,).
        accuracy: Share of right answers in both, 0.5 to below 1.

    Raises:
        PerceptionError: There are not two classes, or the accuracy is out of range.
    """
    if mean.shape != (2,) or not 0.5 <= accuracy < 1.0:
        raise PerceptionError(f"Wald's bound is for two classes and 0.5 to 1, not {mean.shape}, {accuracy}")
    asked = (2.0 * accuracy - 1.0) * np.log(accuracy / (1.0 - accuracy))
    first, second = _divergence(mean, sd), _divergence(mean[::-1], sd[::-1])
    return float(0.5 * asked * (1.0 / first + 1.0 / second))


def _divergence(mean: Float64Array, sd: Float64Array) -> float:
    """Return KL(N_0 | N_1) in nats."""
    ratio = (sd[0] / sd[1]) ** 2
    return float(0.5 * (ratio - 1.0 - np.log(ratio) + ((mean[1] - mean[0]) / sd[1]) ** 2))


def probe_capacity_bits(mean: Float64Array, sd: Float64Array, *, parts: int = 40) -> float:
    """Return the most that one reading can tell of three classes, bits, over settings and beliefs.

    Where readings are independent given the class, n probes of any policy tell n times that at most.

    Args:
        mean: Mean reading, shape (3, k).
        sd: Standard deviation, shape (3, k).
        parts: Steps along an edge of the grid of beliefs.
    """
    steps = [(i, j, parts - i - j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    grid = np.array(steps, dtype=np.float64) / parts
    shape = (len(grid), mean.shape[1], mean.shape[0])
    gains = expected_gains_bits(
        grid, np.broadcast_to(mean.T, shape), np.broadcast_to(sd.T, shape), node_count=65
    )
    return float(gains.max())


def fano_accuracy(information_bits: float, class_count: int) -> float:
    """Return the largest share of right answers that an information permits, from a flat belief.

    Fano's inequality: H(d) - I <= h(e) + e log2(m - 1), solved for the error e.

    Args:
        information_bits: Mutual information of the class and all readings.
        class_count: Number of classes m, at least 2.
    """
    left = np.log2(class_count) - max(information_bits, 0.0)
    if left <= 0.0:
        return 1.0

    def slack(error: float) -> float:
        spread = -error * np.log2(error) - (1.0 - error) * np.log2(1.0 - error)
        return float(spread + error * np.log2(class_count - 1.0) - left)

    worst = 1.0 - 1.0 / class_count
    return 1.0 - (worst if slack(worst) <= 0.0 else float(brentq(slack, 1e-15, worst)))


def shared_optimum(
    model: latent.OffsetModel,
    costs: Sequence[float],
    rng: np.random.Generator,
    *,
    most: int = 4,
    trial_count: int = 6000,
) -> list[Optimum]:
    """Return the best accuracy and number of probes under a model with shared errors, a pair per price.

    The settings are the best multiset of each size (all of them are tried), each landed on anew, visited in
    the order in which they tell most; the stop is optimal given the class belief, by backward induction with
    the continuation's value regressed on it (Longstaff and Schwartz, 2001). The choice of settings does not
    depend on what was read: for three classes along one line of readings little is lost by that.

    Args:
        model: Readings of one feature, and what stays.
        costs: Prices of a probe in units of a right answer.
        rng: Draws the trials, of which half choose and half judge.
        most: Probes at which it must stop.
        trial_count: Trials drawn per class.
    """
    classes, settings, _ = model.mean.shape
    normals = rng.standard_normal((classes, trial_count, most))
    shared = rng.standard_normal((classes, trial_count, len(model.offset_sd)))
    landings = rng.standard_normal((classes, trial_count, most, len(model.offset_sd)))
    few = normals[:, :_FEW], shared[:, :_FEW], landings[:, :_FEW]
    best = max(
        combinations_with_replacement(range(settings), most),
        key=lambda chosen: _accuracy(_beliefs(model, chosen, *few)),
    )
    order = _greedy(model, best, *few)
    beliefs = _beliefs(model, order, normals, shared, landings)  # (t, m, n, m)
    return [_stopped(beliefs, cost) for cost in costs]


def _beliefs(
    model: latent.OffsetModel,
    settings: Sequence[int],
    normals: Float64Array,
    shared: Float64Array,
    landings: Float64Array,
) -> Float64Array:
    """Return the class belief after each probe, shape (t, m, n, m): true class, trial, class."""
    renew = np.array(model.renewed_by_move, dtype=bool)
    noise = np.sqrt(model.noise[..., 0, 0])
    belief = latent.start(model, normals.shape[0] * normals.shape[1])
    found = []
    for t, setting in enumerate(settings):
        offset = np.where(renew, landings[:, :, t], shared) * model.offset_sd
        slope = model.slope[:, setting, 0]
        reading = (
            model.mean[:, setting, 0][:, None]
            + np.einsum("cl,cnl->cn", slope, offset)
            + noise[:, setting][:, None] * normals[:, :, t]
        )
        belief = latent.update(model, belief, reading.reshape(-1, 1), setting, moved=True)
        found.append(belief.posterior.reshape(*normals.shape[:2], -1))
    return np.array(found)


def _accuracy(beliefs: Float64Array) -> float:
    return float(beliefs[-1].max(axis=-1).mean())


def _greedy(
    model: latent.OffsetModel,
    chosen: Sequence[int],
    normals: Float64Array,
    shared: Float64Array,
    landings: Float64Array,
) -> list[int]:
    """Return the settings in the order in which each next one leaves the belief surest."""
    left, order = list(chosen), list[int]()
    while left:
        ahead = {k: _accuracy(_beliefs(model, [*order, k], normals, shared, landings)) for k in set(left)}
        order.append(max(ahead, key=lambda k: ahead[k]))
        left.remove(order[-1])
    return order


def _stopped(beliefs: Float64Array, cost: float) -> Optimum:
    """Return what the best moment to stop achieves; even trials teach, odd ones are judged."""
    most, classes, _, _ = beliefs.shape
    teach, judge = (beliefs[:, :, half::2].reshape(most, -1, classes) for half in (0, 1))
    rules: list[Float64Array] = []
    worth = teach[-1].max(axis=-1)
    for t in range(most - 2, -1, -1):
        rule, *_ = np.linalg.lstsq(_basis(teach[t]), worth, rcond=None)
        rules.insert(0, rule)
        go = _basis(teach[t]) @ rule - cost > teach[t].max(axis=-1)
        worth = np.where(go, worth - cost, teach[t].max(axis=-1))
    flat_go = worth.mean() - cost > 1.0 / classes
    if not flat_go:
        return Optimum(cost, 1.0 / classes, 0.0)
    going, sure, probes = np.ones(len(judge[0]), dtype=bool), np.zeros(len(judge[0])), np.zeros(len(judge[0]))
    for t in range(most):
        probes[going], sure[going] = t + 1, judge[t][going].max(axis=-1)
        if t < most - 1:
            going = going & (_basis(judge[t]) @ rules[t] - cost > judge[t].max(axis=-1))
    return Optimum(cost, float(sure.mean()), float(probes.mean()))


def _basis(belief: Float64Array) -> Float64Array:
    """Return smooth functions of a class belief that do not depend on the order of the classes' names."""
    ranked = np.sort(belief, axis=-1)[:, ::-1]
    top, second = ranked[:, 0], ranked[:, 1]
    return np.stack(
        [
            np.ones(len(top)),
            top,
            top**2,
            top**3,
            second,
            second**2,
            top * second,
            belief[:, 0],
            belief[:, -1],
        ],
        axis=1,
    )
