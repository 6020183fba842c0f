"""In which order the phantoms are given to a person: as published, or balanced over persons."""

import itertools
from collections.abc import Sequence
from typing import Literal

import numpy as np

from palp_core.errors import PerceptionError

Order = Literal["paper", "counterbalanced"]

TABLE_3_MM = (2, 4, 8) * 5
"""Depths of the training phase by trial, mm: Table 3 of the paper."""

TABLE_4_MM = (2, 8, 2, 4, 4, 8, 4, 2, 8, 4, 8, 4, 2, 8, 2)
"""Depths of the estimation phase by trial, mm: Table 4 of the paper."""


def paper_order(depths_m: Sequence[float], table_mm: Sequence[int]) -> list[int]:
    """Return which of the phantoms each trial of a published table has."""
    place = {round(depth_m * 1e3, 6): i for i, depth_m in enumerate(depths_m)}
    if len(place) != len(depths_m) or place.keys() != set(table_mm):
        have = ", ".join(f"{depth_m * 1e3:g}" for depth_m in depths_m)
        raise PerceptionError(
            f"the paper's order has one phantom each of 2, 4 and 8 mm, and there are {have} mm; "
            "use order:=counterbalanced"
        )
    return [place[mm] for mm in table_mm]


def williams(count: int) -> list[list[int]]:
    """Return sequences in which each item follows each other equally often (Williams, 1949).

    A row a sequence: ``count`` rows for an even count, twice as many for an odd one.

    >>> sorted(williams(3)) == sorted(map(list, itertools.permutations(range(3))))
    True
    """
    first = [(step + 1) // 2 if step % 2 else (count - step // 2) % count for step in range(count)]
    square = [[(item + shift) % count for item in first] for shift in range(count)]
    return square if count % 2 == 0 else square + [row[::-1] for row in square]


def counterbalanced(count: int, blocks: int, subject: int, seed: int) -> list[int]:
    """Return the order of a subject: in each block every phantom once, balanced over subjects.

    Over as many subjects as :func:`williams` has rows, each block has every row once. The seed says which
    phantom is which item and which row a block begins with; it is the same for all subjects of a study.
    """
    rows = williams(count)
    rng = np.random.default_rng((seed, count))
    items = rng.permutation(count)
    begins = list(itertools.islice(_rounds(len(rows), rng), blocks))
    return [int(items[item]) for begin in begins for item in rows[(begin + subject - 1) % len(rows)]]


def _rounds(count: int, rng: np.random.Generator) -> itertools.chain[int]:
    """Yield all of 0 ... count - 1 in a new order, again and again."""
    return itertools.chain.from_iterable(rng.permutation(count).tolist() for _ in itertools.count())
