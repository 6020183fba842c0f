"""Ring positions that training covers, and that a policy may therefore command."""

import math
from collections.abc import Iterable, Sequence

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.figure5 import RINGS_M

LARGEST_MM = 49.0
"""What an L12-50 with its zero 1 mm off the stop can reach."""

PUBLISHED = ", ".join(f"{ring_m * 1e3:g}" for ring_m in RINGS_M)
"""The paper's, as a launch file writes them."""

_SAME_M = 1e-9


def rings_of(text: str) -> tuple[float, ...]:
    """Return the ring positions, m, that a text names in mm, in rising order.

    >>> rings_of("16, 0 4")
    (0.0, 0.004, 0.016)
    """
    found = set()
    for word in text.replace(",", " ").split():
        try:
            ring_mm = float(word)
        except ValueError:
            raise PerceptionError(f"'{word}' is not a ring position in mm; write {PUBLISHED}") from None
        if not 0.0 <= ring_mm <= LARGEST_MM:
            raise PerceptionError(
                f"a ring position of {word} mm does not lie between 0 and {LARGEST_MM:g} mm"
            )
        found.add(round(ring_mm * 1e-3, 9))
    if not found:
        raise PerceptionError(f"no ring position is named; write {PUBLISHED}")
    return tuple(sorted(found))


def is_trained(ring_m: float, trained_m: Iterable[float]) -> bool:
    """Return whether a ring position is one of those."""
    return any(math.isclose(ring_m, trained, rel_tol=0.0, abs_tol=_SAME_M) for trained in trained_m)


def untrained(asked_m: Iterable[float], trained_m: Sequence[float]) -> str:
    """Return what is wrong with ring positions, m, that are asked for; "" if all of them are trained.

    >>> untrained([0.0, 0.013], (0.0, 0.004))
    'ring position 13 mm is not trained; trained are 0, 4 mm'
    """
    wrong = [f"{ring_m * 1e3:g}" for ring_m in asked_m if not is_trained(ring_m, trained_m)]
    if not wrong:
        return ""
    known = ", ".join(f"{ring_m * 1e3:g}" for ring_m in trained_m)
    return f"ring position {', '.join(wrong)} mm is not trained; trained are {known} mm"
