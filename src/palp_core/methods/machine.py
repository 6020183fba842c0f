"""How fast this machine is: the time of one fixed piece of work, beside that where costs were measured."""

import time
from functools import cache
from statistics import median

UNIT_S = 0.0067
"""CPU time of :func:`unit_s`'s work on the machine where the declared costs were measured."""

_ROUNDS = 5


@cache
def unit_s() -> float:
    """Return the CPU time of the fixed work here, in s: half interpreter, half arrays; median of five."""
    import numpy as np

    values = np.linspace(0.0, 1.0, 20_000)
    times = []
    for _ in range(_ROUNDS):
        begun_ns = time.thread_time_ns()
        total = 0
        for i in range(100_000):
            total += i & 7
        for _ in range(20):
            values = np.sort(np.sin(values) + 1e-3)
        times.append((time.thread_time_ns() - begun_ns) / 1e9)
    return median(times)


def slowness() -> float:
    """Return by what declared costs are to be multiplied here, as measured now."""
    return unit_s() / UNIT_S
