"""Estimate a phantom from sweeps over bare gel and beads: modulus, friction, indentation, noise.

Every cell's mean sweep is held against the mechanics. Its ring landed somewhere about its target and its
phantom stood at some height: both are parameters with priors of the rig's own noise, so what they could
explain widens the intervals; so is a factor per depth, by which the contact model may be wrong as far as it
states. Intervals are of the profile likelihood; where the sweeps scatter more than all
this allows, they are widened by the root of chi^2 over its degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from palp_core.errors import MethodError, PalpError
from palp_core.palpation.identification.phantom.cells import MeanSweep
from palp_core.palpation.identification.phantom.problem import NAMES, UNIT, FitProblem, costliest
from palp_core.palpation.mechanics.scene.choice import choose_rung
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.units import Float64Array

__all__ = ["NAMES", "Fitted", "PhantomFit", "fit_phantom"]

_ALIKE = 0.95  # correlation from which two parameters are said not to be told apart
_LOOSE = 1.0  # (high - low) / value from which a parameter is said not to be determined


@dataclass(frozen=True)
class Fitted:
    """A parameter with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class PhantomFit:
    """What the sweeps say.

    Attributes:
        parameters: ``modulus_pa``, ``friction``, ``indentation_m``.
        ring_sd_m: Of the ring's landing, by the scatter of peaks within cells; None with single landings.
        correlation: Of the parameters, in that order, the modulus by its logarithm, shape (3, 3).
        scene: The start's scene with the parameters put in.
        rung: Contact model.
        misfit: chi^2 over its degrees of freedom; about 1 where the model describes the sweeps.
        warnings: What cannot be told, in words.
        cell_count: Cells fitted.
    """

    parameters: dict[str, Fitted]
    ring_sd_m: Fitted | None
    correlation: Float64Array
    scene: Scene
    rung: str
    misfit: float
    warnings: tuple[str, ...]
    cell_count: int


def fit_phantom(cells: Sequence[MeanSweep], start: Scene, noise: RigNoise) -> PhantomFit:
    """Fit the parameters.

    Args:
        cells: Mean sweeps.
        start: Everything that is not fitted, and where the search starts.
        noise: How far ring and height may be off: the priors.

    Raises:
        PalpError: There are fewer points than parameters, or the mechanics have no answer at the start.
        MethodError: No contact rung is good enough for the start's scene.
    """
    problem = FitProblem(cells, start, noise)
    best, cost = _minimised(problem)
    wanted = _wanted(problem, problem.scene(best))
    if wanted not in (None, problem.rung):  # what was found needs another contact model than the start
        problem = FitProblem(cells, problem.scene(best), noise)
        best, cost = _minimised(problem)
    slope = problem.slope(best)
    covariance = np.linalg.pinv(slope.T @ slope)[:3, :3]
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    dof = max(problem.point_count - len(NAMES), 1)
    misfit = 2.0 * cost / dof
    limit = float(chi2.ppf(0.95, 1)) * max(1.0, misfit)
    parameters = {}
    for place, name in enumerate(NAMES):
        ends = problem.profile((best, cost), slope, place, limit, float(sd[place]))
        values = np.array([best[place], *ends]) * UNIT[place]
        parameters[name] = Fitted(*(np.exp(values) if place == 0 else values).tolist())
    found = problem.scene(best)
    return PhantomFit(
        parameters,
        _ring_sd(cells, problem, best),
        correlation,
        found,
        problem.rung,
        misfit,
        (*_warnings(parameters, correlation, misfit, cells), *_of_model(found, problem)),
        len(cells),
    )


def _minimised(problem: FitProblem) -> tuple[Float64Array, float]:
    if not np.isfinite(problem.residuals(problem.start())).all():
        raise PalpError(
            "the mechanics have no answer at the start; give another --scene, nearer to the phantom"
        )
    return problem.minimise()


def _wanted(problem: FitProblem, scene: Scene) -> str | None:
    """Return the rung that the scene's phantoms need; None where one of them gets none."""
    try:
        return costliest(problem.choices(scene))
    except MethodError:
        return None


def _ring_sd(cells: Sequence[MeanSweep], problem: FitProblem, x: Float64Array) -> Fitted | None:
    """Return the landing's spread by the peaks' scatter over positionings, with its chi^2 interval."""
    count = len(cells)
    shift = np.zeros(x.size)
    shift[3 : 3 + count] = 0.2
    squares, dof = 0.0, 0
    for i, (here, there) in enumerate(zip(problem.curves(x), problem.curves(x + shift), strict=True)):
        slope = (there.max() - here.max()) / (0.2 * problem.landing_sd_m[i])
        peaks = cells[i].peaks_n_m
        if cells[i].landing_count == peaks.size > 1 and abs(slope) > 1e-3:
            squares += float(((peaks - peaks.mean()) ** 2).sum()) / slope**2
            dof += peaks.size - 1
    if not dof:
        return None
    low, high = (float(np.sqrt(squares / chi2.ppf(q, dof))) for q in (0.975, 0.025))
    return Fitted(float(np.sqrt(squares / dof)), low, high)


def _warnings(
    parameters: dict[str, Fitted], correlation: Float64Array, misfit: float, cells: Sequence[MeanSweep]
) -> list[str]:
    said = [
        f"{NAMES[i]} and {NAMES[j]} cannot be told apart (correlation {correlation[i, j]:+.3f}): only a "
        "combination of them is known; state one of them, or measure it by itself"
        for i in range(len(NAMES))
        for j in range(i + 1, len(NAMES))
        if abs(correlation[i, j]) > _ALIKE
    ]
    for name, one in parameters.items():
        if one.high - one.low > _LOOSE * abs(one.value):
            said.append(f"{name} is hardly determined: {one.low:.3g} to {one.high:.3g}")
    if all(cell.depth_m > 0.0 for cell in cells):
        said.append("no bare-gel sweep: gel and bead are told apart by the sweeps' flanks alone")
    if misfit > 2.0:
        said.append(
            f"chi^2 is {misfit:.1f} times its degrees of freedom: the model or the stated noise does not "
            "describe these sweeps; the intervals were widened by the root of it"
        )
    return said


def _of_model(scene: Scene, problem: FitProblem) -> list[str]:
    """Say where the rung of the fit is not the one that the fitted scene would get."""
    said = []
    for depth_m in problem.depths_m:
        over = f"over a bead at {depth_m * 1e3:g} mm" if depth_m > 0.0 else "over bare gel"
        try:
            wanted = choose_rung(scene.with_bead(depth_m)).rung
        except MethodError:
            wanted = "none of the rungs"
        if wanted != problem.rung:
            said.append(
                f"{over}, {wanted} would be right enough, not {problem.rung}, with which it was fitted: its "
                "error there is not stated"
            )
    return said
