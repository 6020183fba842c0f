"""Right or wrong explained by factors, the session a random effect: the alternative to variance analysis."""

import warnings
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.anova import NOT_FINITE, Effect, NotTestable, checked
from palp_core.units import Float64Array

Labels = Sequence[Hashable]


def mixed_logit(
    correct: Sequence[float] | Float64Array, factors: Mapping[str, Labels], session: Labels
) -> tuple[Effect, ...] | NotTestable:
    """Return Wald tests of factors in a logit with the session as random intercept (statsmodels).

    Bayesian with normal priors of sd 2 on effects, by Laplace's approximation; main effects only. The prior
    keeps separated cells finite.
    """
    values = checked(correct, session, *factors.values())
    if not np.isfinite(values).all():
        return NotTestable(NOT_FINITE)
    if not np.isin(values, (0.0, 1.0)).all():
        raise PerceptionError("a mixed logit is of outcomes that are right (1) or wrong (0), nothing between")
    if np.ptp(values) == 0.0:
        return NotTestable("the outcome is constant: no effect can be told from none")
    if len(set(session)) < 2:
        return NotTestable("there is one session: its effect cannot be told from the others")
    from statsmodels.genmod.bayes_mixed_glm import (  # type: ignore[import-untyped]
        BinomialBayesMixedGLM,
    )
    from statsmodels.tools.sm_exceptions import ConvergenceWarning  # type: ignore[import-untyped]

    columns: list[Any] = [np.ones(len(values))]
    where: dict[str, list[int]] = {}
    for name, labels in factors.items():
        texts = np.array([str(label) for label in labels])
        for level in np.unique(texts)[1:]:
            where.setdefault(name, []).append(len(columns))
            columns.append((texts == level).astype(np.float64))
        if name not in where:
            return NotTestable(f"factor '{name}' has only one level")
    number = np.unique([str(s) for s in session], return_inverse=True)[1]
    groups = np.eye(number.max() + 1)[number]
    design = np.column_stack(columns)
    model = BinomialBayesMixedGLM(
        values, design, groups, np.zeros(groups.shape[1], dtype=int), vcp_p=1.0, fe_p=2.0
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # asked for below
        found = model.fit_map(rng=0)  # its start is drawn; a seed keeps the answer the same
    if not np.linalg.norm(found.optim_retvals.jac) < 0.1 * np.sqrt(len(values)):
        return NotTestable("the fit of the mixed logit did not converge")
    mean, cov = (
        np.asarray(found.fe_mean),
        np.asarray(found.cov_params())[: design.shape[1], : design.shape[1]],
    )
    effects = []
    for name, places in where.items():
        part = mean[places]
        wald = float(part @ np.linalg.solve(cov[np.ix_(places, places)], part))
        effects.append(Effect(name, len(places), wald, float(scipy.stats.chi2.sf(wald, len(places)))))
    return tuple(effects)
