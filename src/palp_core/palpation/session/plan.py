"""The experiment as a generator: what to do next, given what came of the last step.

A plan yields typed steps and is sent a :class:`StepReply` to each. It holds no device and no clock, so it can
be run dry, and a run that was interrupted resumes by sending the recorded replies to a fresh
plan::

    plan = experiment(design, np.random.default_rng(seed))
    step = resume(plan, recorded)   # the first step without a reply, or None at the end
"""

import itertools
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from palp_core.counted import counted
from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M, RINGS_M

Phase = Literal["training", "estimation", "stay", "reposition", "remount", "hour"]
"""The experiment's two, and the conditions of the plan ``repeatability``."""
Specimens = Literal["same", "other"]
"""Whether trials are of the phantoms of training, or of others."""


@dataclass(frozen=True)
class PlannedPhantom:
    """A phantom by the code that may be shown, and the depth of its nodule, m."""

    code: str
    depth_m: float


@dataclass(frozen=True)
class MountPhantom:
    """Put a phantom on the rig, again even if it is the same one."""

    phantom: str


@dataclass(frozen=True)
class Rehome:
    """Send the ring's actuator to its home before it is positioned again."""


@dataclass(frozen=True)
class Wait:
    """Leave everything as it is for a while."""

    duration_s: float


@dataclass(frozen=True)
class BeginTrial:
    """Begin a trial: forget the belief."""

    index: int  # place of the trial in the session, from 0, over all phases; messages are matched by it
    number: int  # number of the trial in its phase, from 1: what people are shown and name
    phase: Phase  # ``training``, ``estimation``, or a condition of another plan
    phantom: str  # code of the mounted phantom
    label_known: bool  # whether the depth is public: in training only
    label_m: float  # the depth, m; 0 where it is not public


@dataclass(frozen=True)
class Palpate:
    trial: int  # index of its trial
    iteration: int  # number of the palpation in the trial, from 1
    ring_given: bool  # whether the plan sets the ring or, in estimation, a policy does
    ring_m: float  # ring position, m; 0 where a policy sets it


Step = MountPhantom | Rehome | BeginTrial | Palpate | Wait


@dataclass(frozen=True)
class StepReply:
    """How a step of the experiment ended."""

    # ``done`` for any step but a palpation in estimation, which is answered by the verdict: ``continue``,
    # ``decided``, ``undecided`` or ``dropped``. ``failed`` repeats a palpation
    word: Literal["done", "continue", "decided", "undecided", "dropped", "failed"] = "done"


Plan = Generator[Step, StepReply, None]

StepT = TypeVar("StepT")
ReplyT = TypeVar("ReplyT")


@dataclass(frozen=True)
class ListedMounting:
    """A mounting of a list: phase, the phantom's code, a ring per trial, m (0 where a policy sets it)."""

    phase: Phase
    phantom: str
    rings_m: tuple[float, ...]


@dataclass(frozen=True)
class ExperimentDesign:
    """The experiment's numbers.

    Attributes:
        phantoms: The phantoms; one per depth as published, several allowed.
        specimens: Trials are of the ``same`` phantoms as training, or of ``other`` ones: of each depth the
            first half is trained on, and the trials are of the second.
        rings_m: Ring positions to train, m.
        repeats: Training palpations per phantom and ring; 25 as published. Each is a trial of one palpation.
        trials_per_phantom: Estimation trials per phantom; 100 as published.
        order: ``randomised`` mixes phantoms and rings as far as mounting allows; ``blocked`` goes through
            them in turn. Not published.
        rehome: Before each ``palpation``, each ``trial``, or each new ``condition`` (phantom and ring in
            training, phantom in estimation), or ``never``. Not published.
        training_mounts: Times each phantom is mounted in training, its palpations spread evenly. Not
            published.
        estimation_mounts: The same in estimation.
        listed: Mountings in the order of a list, which then counts and not the numbers above.
    """

    phantoms: tuple[PlannedPhantom, ...] = tuple(
        PlannedPhantom(code, d) for code, d in zip("ABC", DEPTHS_M, strict=True)
    )
    specimens: Specimens = "same"
    rings_m: tuple[float, ...] = RINGS_M
    repeats: int = 25
    trials_per_phantom: int = 100
    order: Literal["randomised", "blocked"] = "randomised"
    rehome: Literal["palpation", "trial", "condition", "never"] = "trial"
    training_mounts: int = 1
    estimation_mounts: int = 1
    listed: tuple[ListedMounting, ...] = ()

    @property
    def training_count(self) -> int:
        """Palpations of training in all."""
        if self.listed:
            return sum(len(one.rings_m) for one in self.listed if one.phase == "training")
        return self.repeats * len(self.phantoms_of("training")) * len(self.rings_m)

    @property
    def trial_count(self) -> int:
        """Trials of estimation in all."""
        if self.listed:
            return sum(len(one.rings_m) for one in self.listed if one.phase == "estimation")
        return self.trials_per_phantom * len(self.phantoms_of("estimation"))

    def phantoms_of(self, phase: str) -> tuple[PlannedPhantom, ...]:
        """Return the phantoms of training or of estimation."""
        if self.specimens == "same":
            return self.phantoms
        later = phase != "training"
        return tuple(
            phantom
            for alike in self._of_each_depth()
            for place, phantom in enumerate(alike)
            if (2 * place >= len(alike)) == later
        )

    def _of_each_depth(self) -> Iterator[list[PlannedPhantom]]:
        for depth_m in dict.fromkeys(phantom.depth_m for phantom in self.phantoms):
            yield [phantom for phantom in self.phantoms if phantom.depth_m == depth_m]

    def __post_init__(self) -> None:
        if self.order not in ("randomised", "blocked"):
            raise PerceptionError(f"no order '{self.order}'; use 'randomised' or 'blocked'")
        if self.rehome not in ("palpation", "trial", "condition", "never"):
            raise PerceptionError(
                f"no rehome '{self.rehome}'; use 'palpation', 'trial', 'condition' or 'never'"
            )
        if len({p.code for p in self.phantoms}) != len(self.phantoms):
            raise PerceptionError("two phantoms have the same code")
        for alike in self._of_each_depth() if self.specimens == "other" else ():
            if len(alike) % 2:
                raise PerceptionError(
                    f"specimens is other, and {counted(len(alike), 'phantom')} cannot be halved at "
                    f"{alike[0].depth_m * 1e3:g} mm; list an even number of each depth"
                )
        for name, mounts, total in (
            ("training_mounts", self.training_mounts, self.repeats),
            ("estimation_mounts", self.estimation_mounts, self.trials_per_phantom),
        ):
            if total < 0 or mounts < 1 or (total and mounts > total):
                raise PerceptionError(
                    f"{name} is {mounts} for {total} repeats; it must lie between 1 and that number"
                )


def experiment(
    design: ExperimentDesign, rng: np.random.Generator, again: Sequence[tuple[int, str]] = ()
) -> Plan:
    """Yield the steps of training, then of estimation, then of what is to be done again.

    ``again`` has number and phantom of trials of estimation that are done once more at the end, each on a
    mounting of its own; it may grow until then.
    """
    numbers: Counter[str] = Counter()
    homed: tuple[str, float] | None = None
    for phase, phantom, rings_m in _mountings(design, rng):
        yield from _done(MountPhantom(phantom.code))
        for ring_m in rings_m:
            condition = (phase + phantom.code, ring_m)
            homes = design.rehome == "trial" or (design.rehome == "condition" and condition != homed)
            homed = condition
            yield from _trial(design, numbers, phase, phantom, ring_m, homes=homes)
    by_code = {phantom.code: phantom for phantom in design.phantoms}
    for place in itertools.count():
        if place == len(again):  # asked again each time: a mark may have come meanwhile
            return
        phantom = by_code[again[place][1]]
        yield from _done(MountPhantom(phantom.code))
        yield from _trial(design, numbers, "estimation", phantom, 0.0, homes=design.rehome != "never")


def _trial(
    design: ExperimentDesign,
    numbers: Counter[str],
    phase: Phase,
    phantom: PlannedPhantom,
    ring_m: float,
    *,
    homes: bool,
) -> Plan:
    """Yield the steps of a trial and count it; before it the ring is homed if ``homes``."""
    index, training = numbers.total(), phase == "training"
    numbers[phase] += 1
    depth_m = phantom.depth_m if training else 0.0
    yield from _done(BeginTrial(index, numbers[phase], phase, phantom.code, training, depth_m))
    if homes and design.rehome != "palpation":
        yield from _done(Rehome())
    iteration, word = 1, "continue"
    while word in ("continue", "failed"):
        if design.rehome == "palpation":
            yield from _done(Rehome())
        word = (yield Palpate(index, iteration, training, ring_m)).word
        if word not in (
            ("done", "failed") if training else ("continue", "decided", "undecided", "dropped", "failed")
        ):
            raise PerceptionError(
                f"palpation {iteration} of {phase} trial {numbers[phase]} was answered '{word}'"
            )
        iteration += word != "failed"


def _done(step: Step) -> Plan:
    reply = yield step
    if reply.word != "done":
        raise PerceptionError(f"{step} was answered '{reply.word}', not 'done'")


def _mountings(
    design: ExperimentDesign, rng: np.random.Generator
) -> Iterator[tuple[Phase, PlannedPhantom, list[float]]]:
    """Yield for every mounting its phase, phantom and ring per trial (0 where a policy sets it)."""
    if design.listed:
        by_code = {phantom.code: phantom for phantom in design.phantoms}
        for one in design.listed:
            yield one.phase, by_code[one.phantom], list(one.rings_m)
        return
    rounds: list[tuple[Phase, list[float]]] = [
        ("training", [ring for ring in design.rings_m for _ in range(share)])
        for share in _shares(design.repeats, design.training_mounts)
    ]
    rounds += [
        ("estimation", [0.0] * share)
        for share in _shares(design.trials_per_phantom, design.estimation_mounts)
    ]
    for phase, rings_m in rounds:
        phantoms = design.phantoms_of(phase)
        places = np.arange(len(phantoms))
        if design.order == "randomised":
            rng.shuffle(places)
        for place in places:
            order = np.arange(len(rings_m))
            if design.order == "randomised" and phase == "training":
                rng.shuffle(order)
            yield phase, phantoms[place], [rings_m[i] for i in order]


def _shares(total: int, parts: int) -> list[int]:
    """Split a total into nearly equal positive parts, the larger ones first."""
    whole, rest = divmod(total, parts)
    return [share for share in (whole + (part < rest) for part in range(parts)) if share]


def resume(plan: Generator[StepT, ReplyT, None], replies: Iterable[ReplyT]) -> StepT | None:
    """Send recorded replies to a fresh plan and return the first step that has none, or None at its end."""
    step = next(plan, None)
    for reply in replies:
        if step is None:
            raise PerceptionError(
                "the plan ended before its recorded replies; they are of another design or seed"
            )
        try:
            step = plan.send(reply)
        except StopIteration:
            step = None
    return step


def planned(text: str) -> dict[int, str]:
    """Return the class by the number of the trial in which it takes over, counted from 1.

    >>> planned("30=nodes.policy_markov:Markov, 60=nodes.policy_uniform:Uniform")
    {30: 'nodes.policy_markov:Markov', 60: 'nodes.policy_uniform:Uniform'}
    """
    found = {}
    for entry in filter(None, map(str.strip, text.split(","))):
        number, sign, run = entry.partition("=")
        if not sign or not number.strip().isdigit() or ":" not in run:
            raise ValueError(
                f"swaps: '{entry}' is not TRIAL=MODULE:CLASS, as in 30=nodes.policy_markov:Markov"
            )
        found[int(number)] = run.strip()
    return found


def policy_name(run: str) -> str:
    """Return the name of a policy in the record.

    >>> policy_name("nodes.policy_markov:Markov")
    'markov'

    One that a launch file names in another way keeps that name.
    """
    return run.rpartition(":")[2].lower() if ":" in run else run
