"""Task ``block``: how many samples travel in a message; declared for who asks, nodes read :mod:`.blocks`."""

from palp_core.methods import Bound, declare_task, method
from palp_core.palpation.devices.blocks import LENGTHS, WANTED, Length

EVIDENCE = "tests/palpation/session/test_blocks.py"

_SIMULATED, _WALL = {"wall_clock": (0.0, 0.0)}, {"wall_clock": (1.0, 1.0)}
_FASTEST_HZ = 1e5
_LONGEST_SWEEP_S = 4.0

declare_task(
    "block",
    "How long is a block of samples?",
    per="a sample at 1000 Hz, both ends",
    output=WANTED["torque"].output,
    tolerance=WANTED["torque"].age_s,
)


def _bounds(length: Length) -> list[Bound]:
    """Return how old a sample is at most when it is acted upon, for each kind of stream."""
    wall = {one.output: length.length_s + one.under_way_s for one in WANTED.values()}
    return [
        Bound("age_s", length.length_s, within=_SIMULATED),
        *(Bound(output, age_s, within=_WALL) for output, age_s in wall.items()),
    ]


for _length in LENGTHS:
    method(
        task="block",
        name=_length.name,
        cost_s=_length.cost_s,
        bounds=_bounds(_length),
        evidence=EVIDENCE,
        valid={"sample_hz": (1.0 / _length.length_s, _FASTEST_HZ)},
        fails=_length.fails,
        survivor=_length.survivor,
    )(_length)

SWEEP = Length("sweep", _LONGEST_SWEEP_S, 2.0e-8, "nothing is known of a sweep before its end", "50ms")

method(
    task="block",
    name=SWEEP.name,
    cost_s=SWEEP.cost_s,
    bounds=[Bound("age_s", SWEEP.length_s, within={"sweep_s": (0.0, SWEEP.length_s)})],
    evidence=EVIDENCE,
    valid={"sample_hz": (1.0 / SWEEP.length_s, _FASTEST_HZ)},
    fails=SWEEP.fails,
    survivor=SWEEP.survivor,
    reference="shows what is left to gain; a sensor knows of no sweeps, and nodes refuse a block of over 1 s",
)(SWEEP)
