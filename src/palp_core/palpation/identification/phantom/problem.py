"""The sum of squares behind the fit of a phantom: gel, landings, heights, and the model's own error."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from palp_core.errors import MechanicsError, PalpError
from palp_core.palpation.identification.phantom.cells import MeanSweep
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.scene.choice import SceneChoice, choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.units import Float64Array

NAMES = ("modulus_pa", "friction", "indentation_m")
_LOW = np.array([np.log(1e3), 0.0, 5e-4])
_HIGH = np.array([np.log(2e5), 1.5, 1e-2])
UNIT = np.array([0.1, 0.05, 2e-4])  # about equal steps of the logarithm of E, of friction, of indentation
_STEP = 1e-3
_NUMERICS_N_M = 2e-6  # error of the tables' interpolation, and of the rounding's mean (assumed)
_MARGIN_M = 0.002
_TABLE_STEP_M = 0.0005
_HELD_STEPS, _CORRECTIONS = 3, 2
_LOOSENED = (100.0, 1.0)


class FitProblem:
    """Residuals over theta (in :data:`UNIT`), then landings, heights and factors over their priors' sd."""

    def __init__(self, cells: Sequence[MeanSweep], start: Scene, noise: RigNoise) -> None:
        self.cells, self.given = cells, start
        self.mount_count = max(cell.mount for cell in cells) + 1
        self.point_count = sum(cell.stage_m.size for cell in cells)
        if self.point_count <= len(NAMES) + len(cells):
            raise PalpError(f"{self.point_count} points are too few to fit {len(NAMES)} parameters")
        self.landing_sd_m = np.array(
            [max(noise.ring_sd_m.value, 1e-6) / np.sqrt(cell.landing_count) for cell in cells]
        )
        self.height_sd_m = max(noise.height_sd_m.value, 1e-6)
        self.depths_m = sorted({cell.depth_m for cell in cells})
        chosen = self.choices(start)
        self.rung = costliest(chosen)
        bounds = [choice.bound or start.tolerance.relative for choice in chosen]
        self.model_sd = np.array(bounds) / np.sqrt(3.0)  # a bound, taken for the ends of a flat law
        self.nuisance_count = len(cells) + self.mount_count + len(self.depths_m)
        self.sd_n_m = [float(np.hypot(cell.sd_n_m, _NUMERICS_N_M)) for cell in cells]

    def choices(self, scene: Scene) -> list[SceneChoice]:
        """Return what is chosen for the scene over each of the depths.

        Raises:
            MethodError: No contact rung is good enough over one of them.
        """
        return [choose_rung(scene.with_bead(depth_m)) for depth_m in self.depths_m]

    def start(self) -> Float64Array:
        """Return the start: the scene's own numbers, nothing off."""
        theta = np.array(
            [
                np.log(self.given.phantom.modulus_pa),
                self.given.probe.friction,
                self.given.path.indentation_m,
            ]
        )
        return np.concatenate([theta / UNIT, np.zeros(self.nuisance_count)])

    def scene(self, x: Float64Array) -> Scene:
        """Return the scene at a point."""
        log_modulus, friction, indentation_m = (x[:3] * UNIT).tolist()
        given = self.given
        return replace(
            given,
            phantom=replace(given.phantom, modulus_pa=float(np.exp(log_modulus))),
            probe=replace(given.probe, friction=friction),
            path=replace(given.path, indentation_m=indentation_m),
        )

    def curves(self, x: Float64Array) -> list[Float64Array]:
        """Return every cell's torque at its points, N m."""
        scene, count = self.scene(x), len(self.cells)
        landing = x[3 : 3 + count] * self.landing_sd_m
        height = x[3 + count : 3 + count + self.mount_count] * self.height_sd_m
        factor = 1.0 + x[3 + count + self.mount_count :] * self.model_sd
        models = {
            depth_m: rung_model(
                self.rung, scene.with_bead(depth_m).phantom, scene.probe.tip_radius_m, scene.probe.tip
            )
            for depth_m in self.depths_m
        }
        found = []
        for i, cell in enumerate(self.cells):
            low, high = sorted((float(cell.stage_m[0]), float(cell.stage_m[-1])))
            forward = cell.stage_m[-1] > cell.stage_m[0]
            ends = (low - _MARGIN_M, high + _MARGIN_M) if forward else (high + _MARGIN_M, low - _MARGIN_M)
            ring_m = max(cell.ring_m + float(landing[i]), 0.0)
            indentation_m = scene.path.indentation_m + float(height[cell.mount])
            table = solve(
                models[cell.depth_m], scene.probe, ring_m, indentation_m, *ends, step_m=_TABLE_STEP_M
            )
            found.append(factor[self.depths_m.index(cell.depth_m)] * table.torque_n_m(cell.stage_m))
        return found

    def residuals(self, x: Float64Array) -> Float64Array:
        """Return scaled differences, then the priors' own; infinite where the mechanics have no answer."""
        try:
            curves = self.curves(x)
        except MechanicsError:
            return np.full(self.point_count + x.size - 3, np.inf)
        pairs = zip(curves, self.cells, self.sd_n_m, strict=True)
        return np.concatenate([*((curve - cell.torque_n_m) / sd for curve, cell, sd in pairs), x[3:]])

    def slope(self, x: Float64Array) -> Float64Array:
        """Return the residuals' slope; a landing moves only its cell, and so on."""
        base, count = self.curves(x), len(self.cells)
        jacobian = np.zeros((self.point_count + x.size - 3, x.size))
        jacobian[self.point_count :, 3:] = np.eye(x.size - 3)
        rows = np.split(np.arange(self.point_count), np.cumsum([c.stage_m.size for c in self.cells])[:-1])
        kinds = np.repeat(np.arange(6), [1, 1, 1, count, self.mount_count, len(self.depths_m)])
        for kind in range(6):
            first = int(np.flatnonzero(kinds == kind)[0])
            for i, (moved, cell) in enumerate(
                zip(self.curves(x + _STEP * (kinds == kind)), self.cells, strict=True)
            ):
                own = (0, 0, 0, i, cell.mount, self.depths_m.index(cell.depth_m))[kind]
                jacobian[rows[i], first + own] = (moved - base[i]) / (_STEP * self.sd_n_m[i])
        return jacobian

    def nearest(self) -> Float64Array:
        """Return the start, or the point of a coarse grid about it that fits better."""
        start = self.start()
        costs = {}
        for shift in product((-0.7, 0.0, 0.7), (-0.15, 0.0, 0.15), (-1e-3, 0.0, 1e-3)):
            x = start.copy()
            x[:3] = np.clip(x[:3] * UNIT + shift, _LOW, _HIGH) / UNIT
            costs[shift] = (float(np.square(self.residuals(x)).sum()), x)
        return min(costs.values(), key=lambda pair: pair[0])[1]

    def minimise(self) -> tuple[Float64Array, float]:
        """Return where the sum of squares is least, and half of it there.

        First with the points taken for far less certain, so that no landing is bent to fit a wrong gel.
        """
        certain, x = self.sd_n_m, self.nearest()
        for loose in _LOOSENED:
            self.sd_n_m = [loose * sd for sd in certain]
            x, cost = self._descend(x)
        return x, cost

    def _descend(self, start: Float64Array) -> tuple[Float64Array, float]:
        low = np.concatenate([_LOW / UNIT, np.full(start.size - 3, -6.0)])
        high = np.concatenate([_HIGH / UNIT, np.full(start.size - 3, 6.0)])
        found = least_squares(
            self.residuals,
            np.clip(start, low + 1e-9, high - 1e-9),
            jac=self.slope,
            bounds=(low, high),
            xtol=1e-6,
            ftol=1e-6,
            max_nfev=40,
        )
        return np.asarray(found.x), float(found.cost)

    def held(self, best: Float64Array, slope: Float64Array, place: int, value: float) -> float:
        """Return half the least sum of squares with a parameter held.

        Gauss-Newton steps with the slope of the optimum, from the point that the slope alone would give.
        """
        free = np.delete(np.arange(best.size), place)
        back = np.linalg.pinv(slope[:, free])
        x = best.copy()
        x[place] = value
        x[free] -= back @ slope[:, place] * (value - best[place])
        cost = np.inf
        for _ in range(_HELD_STEPS):
            residual = self.residuals(x)
            if not np.isfinite(residual).all():
                break
            cost = min(cost, 0.5 * float(residual @ residual))
            x[free] -= back @ residual
        return cost

    def profile(
        self, best: tuple[Float64Array, float], slope: Float64Array, place: int, limit: float, sd: float
    ) -> tuple[float, float]:
        """Return the ends of a parameter's interval; the search's own bounds where there is none.

        The root of the excess is nearly straight, so that two corrections of its slope are enough.
        """
        x, cost = best
        at, ends = float(x[place]), []
        for reach, bound in ((-sd, _LOW[place] / UNIT[place]), (sd, _HIGH[place] / UNIT[place])):
            end = at + reach * np.sqrt(limit)
            for _ in range(_CORRECTIONS):
                end = max(end, bound) if reach < 0.0 else min(end, bound)
                excess = max(2.0 * (self.held(x, slope, place, end) - cost), 1e-6)
                if not np.isfinite(excess):
                    break
                end = at + (end - at) * np.sqrt(limit / excess)
            ends.append(max(end, bound) if reach < 0.0 else min(end, bound))
        return float(ends[0]), float(ends[1])


def costliest(choices: Sequence[SceneChoice]) -> str:
    """Return the rung that serves all of them: the costliest."""
    return max(choices, key=lambda choice: choice.method.cost_s).rung
