"""The plan ``repeatability``: how much a reading scatters, and which handling makes it scatter.

Sweeps without moving anything (``stay``), with the ring re-positioned (``reposition``), with the phantom
remounted and the ring left alone (``remount``), and before and after a wait (``hour``). A trial is one group:
what differs between groups of a condition, and not within, is what the condition did.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from palp_core.errors import PerceptionError
from palp_core.palpation.session.plan import BeginTrial, MountPhantom, Palpate, Phase, Plan, Rehome, Wait

CONDITIONS: tuple[Phase, ...] = ("stay", "reposition", "remount", "hour")


def is_repeatability(phases: Sequence[str]) -> bool:
    """Return whether a session with these phases followed the plan."""
    return any(phase in CONDITIONS for phase in phases)


@dataclass(frozen=True)
class RepeatDesign:
    """The plan's numbers; all are choices."""

    phantom: str
    # ring positions of ``stay`` and ``reposition``, at least two: their means show how a reading answers to
    # the ring. The last one is that of ``remount`` and ``hour``
    rings_m: tuple[float, ...] = (0.004, 0.008, 0.012, 0.016)
    stay: int = 8  # sweeps without moving anything, per ring
    repositions: int = 10  # positionings per ring
    remounts: int = 16
    hours: int = 2
    wait_s: float = 3600.0
    # sweeps per positioning, mounting, and before and after a wait; at least two, so that what differs
    # between groups is separated from what differs within
    group: int = 2

    def __post_init__(self) -> None:
        if len(self.rings_m) < 2 or len(set(self.rings_m)) < len(self.rings_m):
            raise PerceptionError(f"repeatability needs two or more different rings, not {self.rings_m}")
        least = {"stay": 2, "repositions": 2, "remounts": 2, "hours": 0, "group": 2}
        for name, count in least.items():
            if getattr(self, name) < count:
                raise PerceptionError(f"repeatability: {name} is {getattr(self, name)}; it needs {count}")
        if not self.wait_s >= 0.0:
            raise PerceptionError(f"repeatability: wait_s is {self.wait_s}; it cannot be negative")


def sweep_count(design: RepeatDesign) -> int:
    """Return how many sweeps the plan asks for."""
    each = design.stay + design.repositions * design.group
    waits = (design.hours + 1) * design.group if design.hours else 0
    return len(design.rings_m) * each + design.remounts * design.group + waits


def repeatability(design: RepeatDesign) -> Plan:
    """Yield the steps; the order is fixed, as nothing is to be guessed."""
    numbers: Counter[str] = Counter()
    for index, (before, phase, ring_m, count) in enumerate(_groups(design)):
        numbers[phase] += 1
        begin = BeginTrial(index, numbers[phase], phase, design.phantom, label_known=False, label_m=0.0)
        for step in (*before, begin):
            yield from _until_done(step)
        for iteration in range(1, count + 1):
            yield from _until_done(Palpate(index, iteration, ring_given=True, ring_m=ring_m))


def _until_done(step: MountPhantom | Rehome | Wait | BeginTrial | Palpate) -> Plan:
    word = (yield step).word
    while word == "failed" and isinstance(step, Palpate):
        word = (yield step).word
    if word != "done":
        raise PerceptionError(f"{step} was answered '{word}', not 'done'")


def _groups(
    design: RepeatDesign,
) -> Iterator[tuple[tuple[MountPhantom | Rehome | Wait, ...], Phase, float, int]]:
    """Yield for every group the handling before it, its condition, ring and number of sweeps."""
    mount, rehome = MountPhantom(design.phantom), Rehome()
    first: tuple[MountPhantom | Rehome | Wait, ...] = (mount,)
    for ring_m in design.rings_m:
        yield (*first, rehome), "stay", ring_m, design.stay
        first = ()
        for _ in range(design.repositions):
            yield (rehome,), "reposition", ring_m, design.group
    last_m = design.rings_m[-1]
    for _ in range(design.remounts):
        yield (mount,), "remount", last_m, design.group
    if design.hours:
        yield (), "hour", last_m, design.group
        for _ in range(design.hours):
            yield (Wait(design.wait_s),), "hour", last_m, design.group
