"""Symmetric positive definite systems of finite elements, solved by condensing halves into one another."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from palp_core.units import Float64Array

Ints = NDArray[np.int64]
LEAF = 4  # elements that are condensed at once


@dataclass
class Part:
    """Elements that are condensed onto what they share with others."""

    unknowns: Ints  # All of them, rising
    inside: Ints  # Places, within the unknowns of all, of those that no other part has
    border: Ints  # Of the others
    elements: Ints  # Numbers of the elements of a leaf; none in a node with halves
    halves: tuple[Part, ...] = ()  # Parts that this one joins
    places: list[Ints] = field(default_factory=list)
    factor: Float64Array | None = None
    across: Float64Array | None = None

    @property
    def outer(self) -> Ints:
        """Unknowns shared with others."""
        return self.unknowns[self.border]


class Condensed:
    """Symmetric positive definite systems of element matrices, solved by nested halves."""

    def __init__(self, unknowns: Ints, places: Float64Array) -> None:
        self._unknowns, self._places = unknowns, places
        self._users = np.bincount(unknowns[unknowns >= 0].ravel())
        self._root, _ = self._build(np.arange(unknowns.shape[0]))

    def _build(self, elements: Ints) -> tuple[Part, Ints]:
        if elements.size <= LEAF:
            own = self._unknowns[elements].ravel()
            unknowns, counts = np.unique(own[own >= 0], return_counts=True)
            halves: tuple[Part, ...] = ()
        else:
            at = self._places[:, elements]
            order = np.argsort(at[int(np.argmax(np.ptp(at, axis=1)))], kind="stable")
            cut = elements.size // 2
            built = [self._build(elements[order[:cut]]), self._build(elements[order[cut:]])]
            halves = built[0][0], built[1][0]
            shared = np.concatenate([half.outer for half in halves])
            held = np.concatenate([counts for _, counts in built])
            unknowns, which = np.unique(shared, return_inverse=True)
            counts = np.bincount(which, held).astype(np.int64)
        done = counts == self._users[unknowns]
        part = Part(unknowns, np.flatnonzero(done), np.flatnonzero(~done), elements, halves)
        for half in halves:
            part.places.append(np.searchsorted(unknowns, half.outer))
        return part, counts[~done]

    def solve(self, matrices: Float64Array, load: Float64Array) -> Float64Array:
        """Solve for element matrices, (elements, n, n), and a load by unknown."""
        self._condense(self._root, matrices)
        right = load.copy()
        self._forward(self._root, right)
        self._back(self._root, right)
        return right

    def _condense(self, part: Part, matrices: Float64Array) -> Float64Array:
        size = part.unknowns.size
        front = np.zeros((size, size))
        for half, places in zip(part.halves, part.places, strict=True):
            front[np.ix_(places, places)] += self._condense(half, matrices)
        if not part.halves:
            for e in part.elements:
                own = self._unknowns[e]
                used = np.flatnonzero(own >= 0)
                at = np.searchsorted(part.unknowns, own[used])
                np.add.at(front, (at[:, None], at[None, :]), matrices[e][np.ix_(used, used)])
        a, b = part.inside, part.border
        part.factor = cholesky(front[np.ix_(a, a)], lower=True, check_finite=False)
        part.across = solve_triangular(part.factor, front[np.ix_(a, b)], lower=True, check_finite=False)
        return np.asarray(front[np.ix_(b, b)] - part.across.T @ part.across)

    def _forward(self, part: Part, right: Float64Array) -> None:
        for half in part.halves:
            self._forward(half, right)
        assert part.factor is not None
        assert part.across is not None
        inside = part.unknowns[part.inside]
        right[inside] = solve_triangular(part.factor, right[inside], lower=True, check_finite=False)
        right[part.outer] -= part.across.T @ right[inside]

    def _back(self, part: Part, right: Float64Array) -> None:
        assert part.factor is not None
        assert part.across is not None
        inside = part.unknowns[part.inside]
        right[inside] -= part.across @ right[part.outer]
        right[inside] = solve_triangular(
            part.factor, right[inside], lower=True, trans="T", check_finite=False
        )
        for half in part.halves:
            self._back(half, right)
