"""What no other choice beats in both of two costs."""

from collections.abc import Sequence

import numpy as np


def pareto_front(first: Sequence[float], second: Sequence[float]) -> list[int]:
    """Return the indices that nothing beats in both costs, by rising first; of equals one, NaN is no entry.

    >>> pareto_front([1.0, 2.0, 3.0], [0.5, 0.1, 0.2])
    [0, 1]
    """
    front: list[int] = []
    known = [i for i in range(len(first)) if np.isfinite(first[i]) and np.isfinite(second[i])]
    for i in sorted(known, key=lambda i: (first[i], second[i])):
        if not front or second[i] < second[front[-1]]:
            front.append(i)
    return front
