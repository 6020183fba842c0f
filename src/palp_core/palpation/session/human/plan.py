"""The experiment with a person as a generator: identity, MVC, training, estimation.

As :mod:`palp_core.palpation.session.plan`: it holds no device, no clock and no person, so it can be run dry,
and goes on from recorded replies.

>>> outline(HumanDesign()).questions
15
"""

import itertools
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.session.audit import TrialKey
from palp_core.palpation.session.plan import ExperimentDesign, PlannedPhantom

Phase = Literal["training", "estimation"]
PHASES: tuple[Phase, ...] = ("training", "estimation")
Order = Literal["paper", "counterbalanced"]

TABLE_3_MM = (2, 4, 8) * 5
"""Depths of the training phase by trial, mm: Table 3 of the paper."""

TABLE_4_MM = (2, 8, 2, 4, 4, 8, 4, 2, 8, 4, 8, 4, 2, 8, 2)
"""Depths of the estimation phase by trial, mm: Table 4 of the paper."""

PAPER_REPEATS = 5
PAPER_LIMIT_S = 60.0


@dataclass(frozen=True)
class Identify:
    """Ask for consent and subject code."""


@dataclass(frozen=True)
class Quiet:
    duration_s: float


@dataclass(frozen=True)
class HoldMvc:
    """Record the maximum voluntary contraction; answered ``repeat`` where it cannot be used."""

    attempt: int
    mass_kg: float
    duration_s: float


@dataclass(frozen=True)
class Rest:
    duration_s: float


@dataclass(frozen=True)
class HumanTrial:
    """Let the subject palpate, until the operator ends it or the time is over."""

    index: int  # number of the trial, from 0, over both phases
    phase: Phase
    number: int  # of the trial in its phase, from 1
    attempt: int  # from 1; a trial that was spoilt is done again
    phantom: str
    depth_m: float | None  # of its nodule; None where it is sealed
    told: bool  # whether the subject is told the depth
    limit_s: float


@dataclass(frozen=True)
class Ask:
    trial: HumanTrial


HumanStep = Identify | Quiet | HoldMvc | Rest | HumanTrial | Ask


@dataclass(frozen=True)
class HumanReply:
    """What came of a step; ``repeat`` is an answer to an MVC or a trial."""

    word: Literal["done", "repeat"] = "done"


HumanPlan = Generator[HumanStep, HumanReply, None]


@dataclass(frozen=True)
class HumanDesign:
    """The numbers of a session with a person.

    Attributes:
        phantoms: One per depth as published.
        order: ``paper``: Tables 3 and 4, the same for all; ``counterbalanced``.
        subject_number: Of the subject in the study, from 1; of the counterbalanced order.
        seed: Of the study; of the counterbalanced order.
        repeats: Trials per phantom and phase; 5 as published.
        limit_s: Longest time of a trial; 60 s as published.
        rest_s: Between trials (published: they rested; how long is assumed).
        quiet_s: Of muscles at rest before the MVC (assumed).
        mvc_s: Of the MVC (assumed).
        mass_kg: That is held and moved in it; 5 kg as published.
        mvc_tries: After which the session ends without a usable one (assumed).
        sealed: In a blinded session the codes of estimation, in an order that says nothing; empty where
            depths are known.
    """

    phantoms: tuple[PlannedPhantom, ...] = ExperimentDesign().phantoms
    order: Order = "paper"
    subject_number: int = 1
    seed: int = 1
    repeats: int = PAPER_REPEATS
    limit_s: float = PAPER_LIMIT_S
    rest_s: float = 20.0
    quiet_s: float = 2.0
    mvc_s: float = 5.0
    mass_kg: float = 5.0
    mvc_tries: int = 4
    sealed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.order not in ("paper", "counterbalanced"):
            raise PerceptionError(f"no order '{self.order}'; use 'paper' or 'counterbalanced'")
        if len(self.phantoms) < 2 or len({p.depth_m for p in self.phantoms}) < len(self.phantoms):
            raise PerceptionError("the question is which of several depths: phantoms need two different ones")
        if self.repeats < 1 or self.subject_number < 1 or self.mvc_tries < 1:
            raise PerceptionError("repeats, subject_number and mvc_tries are counted from 1")
        if self.order == "paper" and self.repeats != PAPER_REPEATS:
            raise PerceptionError(
                f"repeats is {self.repeats}, and the paper's order has {PAPER_REPEATS} trials per phantom; "
                "use order:=counterbalanced"
            )
        if self.sealed and self.order == "paper":
            raise PerceptionError(
                "the paper's order is published, and with it the depth of each trial: a blinded session "
                "takes order:=counterbalanced"
            )
        for name in ("limit_s", "mvc_s", "mass_kg"):
            if not getattr(self, name) > 0.0:
                raise PerceptionError(f"{name} is {getattr(self, name)}; it must be positive")
        self.places("training")

    def places(self, phase: Phase) -> list[int]:
        """Return which phantom each trial of a phase has."""
        if self.order == "paper":
            table = TABLE_3_MM if phase == "training" else TABLE_4_MM
            return paper_order([p.depth_m for p in self.phantoms], table)
        seed = 2 * self.seed + (phase == "estimation")
        return counterbalanced(len(self.phantoms), self.repeats, self.subject_number, seed)


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


def human(design: HumanDesign, again: Sequence[TrialKey] = ()) -> HumanPlan:
    """Yield the steps of a session.

    ``again`` has trials that are done once more at the end; it may grow until then.
    """
    yield from _done(Identify())
    yield from _done(Quiet(design.quiet_s))
    for attempt in range(1, design.mvc_tries + 1):
        if (yield HoldMvc(attempt, design.mass_kg, design.mvc_s)).word == "done":
            break
        yield from _done(Rest(design.rest_s))
    else:
        raise PerceptionError(
            f"{design.mvc_tries} contractions, none usable as MVC; lower the amplifier's gain (clipped), or "
            "check the electrodes (weak)"
        )
    done = list(trials(design))
    for trial in done.copy():
        yield from _trial(trial, design.rest_s)
    for place in itertools.count():
        if place == len(again):  # asked again each time: a mark may have come meanwhile
            return
        first = next(one for one in done if (one.phase, one.number) == again[place])
        number = 1 + sum(one.phase == first.phase for one in done)
        done.append(replace(first, index=len(done), number=number))
        yield from _trial(done[-1], design.rest_s)


def _trial(trial: HumanTrial, rest_s: float) -> HumanPlan:
    """Yield the steps of a trial, as often as it is spoilt."""
    yield from _done(Rest(rest_s))
    while (yield trial).word == "repeat":
        trial = replace(trial, attempt=trial.attempt + 1)
        yield from _done(Rest(rest_s))
    if trial.phase == "estimation":
        yield from _done(Ask(trial))


def trials(design: HumanDesign) -> Iterator[HumanTrial]:
    index = 0
    for phase in PHASES:
        told = phase == "training"
        known = told or not design.sealed
        for number, place in enumerate(design.places(phase), start=1):
            code = design.phantoms[place].code if known else design.sealed[place]
            depth_m = design.phantoms[place].depth_m if known else None
            yield HumanTrial(index, phase, number, 1, code, depth_m, told, design.limit_s)
            index += 1


def _done(step: HumanStep) -> HumanPlan:
    reply = yield step
    if reply.word != "done":
        raise PerceptionError(f"{step} was answered '{reply.word}', not 'done'")


@dataclass(frozen=True)
class PlanOutline:
    """What a plan asks for, found by running it dry with every step done at once."""

    trials: tuple[HumanTrial, ...]
    questions: int  # how often the subject is asked
    shortest_s: float  # without any palpation
    longest_s: float  # if every trial takes its limit
    mounts: int  # times that the phantom changes


def outline(design: HumanDesign) -> PlanOutline:
    """Run a plan dry, without a person or a rig."""
    plan = human(design)
    step: HumanStep | None = next(plan)
    found: list[HumanTrial] = []
    questions, waits_s = 0, 0.0
    while step is not None:
        if isinstance(step, HumanTrial):
            found.append(step)
        elif isinstance(step, Ask):
            questions += 1
        elif not isinstance(step, Identify):
            waits_s += step.duration_s
        try:
            step = plan.send(HumanReply())
        except StopIteration:
            step = None
    codes = ["", *(trial.phantom for trial in found)]
    return PlanOutline(
        tuple(found),
        questions,
        waits_s,
        waits_s + sum(trial.limit_s for trial in found),
        sum(a != b for a, b in itertools.pairwise(codes)),
    )
