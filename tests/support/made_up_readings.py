"""A made-up experiment with a known truth: materials, actions, and readings of two correlated numbers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from palp_core.palpation.readings.readings import Readings

MATERIALS = ("felt", "silk", "wool")
ACTIONS = ("press", "slide")
COLUMNS = ("force", "pitch")


@dataclass(frozen=True, eq=False)
class MadeUp:
    """Names and readings, a row each, and the laws that they were drawn from.

    Attributes:
        values: Shape (n, 2).
        materials: Index of each row's material.
        actions: Index of each row's action.
        trials: Number of each row's trial.
        mean: Of each material and action, shape (3, 2, 2).
        cov: Likewise, shape (3, 2, 2, 2).
    """

    values: NDArray[np.float64]
    materials: NDArray[np.int64]
    actions: NDArray[np.int64]
    trials: NDArray[np.int64]
    mean: NDArray[np.float64]
    cov: NDArray[np.float64]

    def readings(self, columns: int = 2) -> Readings:
        return Readings.of(
            self.values[:, :columns],
            [MATERIALS[i] for i in self.materials],
            settings=[ACTIONS[i] for i in self.actions],
            trials=self.trials,
            columns=COLUMNS[:columns],
        )

    def write(self, path: Path) -> Path:
        """Write the table as anybody would."""
        lines = ["trial,material,action,force,pitch"]
        for row, (x, y) in enumerate(self.values.tolist()):
            names = f"{self.trials[row]},{MATERIALS[self.materials[row]]},{ACTIONS[self.actions[row]]}"
            lines.append(f"{names},{x:.6f},{y:.6f}")
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    def exact(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return each trial's material, and its exact posterior after all its readings, by scipy alone."""
        densities = np.array(
            [
                [
                    stats.multivariate_normal(self.mean[c, k], self.cov[c, k]).logpdf(self.values)
                    for k in (0, 1)
                ]
                for c in range(3)
            ]
        )  # (class, action, row)
        own = densities[:, self.actions, np.arange(len(self.values))].T
        total = np.array([own[self.trials == t].sum(axis=0) for t in np.unique(self.trials)])
        total -= total.max(axis=1, keepdims=True)
        posterior = np.exp(total) / np.exp(total).sum(axis=1, keepdims=True)
        truth = np.array([self.materials[self.trials == t][0] for t in np.unique(self.trials)])
        return truth, posterior


def made_up(trials: int, repeats: int = 1, *, seed: int = 0, apart: float = 0.8) -> MadeUp:
    """Return so many trials of each material, in which each action is done ``repeats`` times."""
    rng = np.random.default_rng(seed)
    mean = apart * rng.normal(size=(3, 2, 2))
    cov = np.array([[[1.0, 0.6], [0.6, 1.0]], [[1.0, -0.5], [-0.5, 2.0]]])[None].repeat(3, axis=0)
    material, _, _, action = (i.ravel() for i in np.indices((3, trials, repeats, 2)))
    number = np.repeat(np.arange(3 * trials), 2 * repeats)
    roots = np.linalg.cholesky(cov[material, action])
    values = mean[material, action] + (roots @ rng.normal(size=(len(number), 2, 1)))[..., 0]
    return MadeUp(values, material, action, number, mean, cov)
