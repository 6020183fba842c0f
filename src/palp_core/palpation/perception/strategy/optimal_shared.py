"""What is possible when readings share errors, by numbers; and the limits of Wald and of Fano.

With errors that stay no recursion over the class belief is exact, for the offsets are part of the state. The
optimum is then found numerically: every probe where it tells most, given all that was read, and the best
moment to stop.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.information import expected_gains_bits
from palp_core.palpation.perception.strategy.optimal import Optimum
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.units import Float64Array


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
    most: int = 15,
    trial_count: int = 4000,
) -> list[Optimum]:
    """Return the best accuracy and number of probes found under a model with shared errors, a pair per price.

    Each probe is the one that tells most about the class given all that was read: any setting landed on anew,
    or a stay. The stop is optimal given the class belief, by backward induction with the continuation's value
    regressed on it (Longstaff and Schwartz, 2001). It is what can be had, and no bound: the choice looks one
    probe ahead. On the published rig the best set of eight settings fixed in advance, of all mixtures of two,
    is 0.1 points better than eight such choices.

    Args:
        model: Readings of one feature, and what stays.
        costs: Prices of a probe in units of a right answer.
        rng: Draws the trials, of which half choose and half judge.
        most: Probes at which it must stop.
        trial_count: Trials drawn per class.
    """
    beliefs = _beliefs(model, most, trial_count, rng)
    return [_stopped(beliefs, cost) for cost in costs]


def _beliefs(
    model: latent.OffsetModel, most: int, trial_count: int, rng: np.random.Generator
) -> Float64Array:
    """Return the class belief after each probe, shape (t, m, n, m): true class, trial, class."""
    classes, settings, _ = model.mean.shape
    truth = np.repeat(np.arange(classes), trial_count)
    renewed, noise = np.array(model.renewed_by_move, dtype=bool), np.sqrt(model.noise[..., 0, 0])
    policy = InformationGainLatent(model, tuple(float(k) for k in range(settings)))
    belief, before = latent.start(model, truth.size), np.full(truth.size, -1)
    at = policy.start(rng.random, truth.size)
    offset = rng.standard_normal((truth.size, renewed.size)) * model.offset_sd
    found = []
    for t in range(most):
        moved = (at.level != before) | at.renew
        anew = rng.standard_normal(offset.shape) * model.offset_sd
        offset = np.where(moved[:, None] & renewed, anew, offset)
        reading = (
            model.mean[truth, at.level, 0]
            + (model.slope[truth, at.level, 0] * offset).sum(axis=-1)
            + noise[truth, at.level] * rng.standard_normal(truth.size)
        )
        belief = latent.update(model, belief, reading[:, None], at.level, moved)
        found.append(belief.posterior.reshape(classes, trial_count, classes))
        before = at.level
        if t + 1 < most:
            at = policy.step(at, belief, rng.random)
    return np.array(found)


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
