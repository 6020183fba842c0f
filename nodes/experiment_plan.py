"""What the experiment is set to do and remembers, the plan that follows from it, and how far it has come."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from msgs.estimation import Belief, Palpation
from msgs.experiment import PolicyChange
from palp_core import Params, Progress, ReadOnly
from palp_core.errors import PalpError, PerceptionError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.stopping import require_classes
from palp_core.palpation.perception.belief.trial_filter import DepthCount
from palp_core.palpation.perception.belief.trial_filter import classes_of as grid_of
from palp_core.palpation.perception.strategy.trained_rings import PUBLISHED, rings_of
from palp_core.palpation.session import plan
from palp_core.palpation.session.audit import note_redone, to_be_redone
from palp_core.palpation.session.method_choices import AUTO
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.palpation.session.orders import GROUPED, ordered
from palp_core.palpation.session.plan import ExperimentDesign, Specimens
from palp_core.palpation.session.plan_repeatability import RepeatDesign, repeatability, sweep_count
from palp_core.palpation.session.row_facts import RowFacts
from palp_core.palpation.session.trials_csv import read_rows
from palp_core.units import Count, CountPositive, Metres, Seconds

TrialCount = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
"""Of trials, or of palpations in training: what a rig can do in its lifetime."""


POLICY = "policy"
"""The node whose place others take."""


def taking_over(swaps: str) -> list[str]:
    """Return the classes of ``TRIAL=MODULE:CLASS,...`` by trial; another form is refused elsewhere."""
    entries = [entry.partition("=") for entry in swaps.split(",") if "=" in entry]
    entries.sort(key=lambda entry: int(entry[0]) if entry[0].strip().isdecimal() else 0)
    return [run.strip() for *_, run in entries]


SwappedIn = Annotated[str, msgspec.Meta(extra={"successors": (POLICY, taking_over)})]
"""Policies that take over: the check of the launch file looks at their classes, too."""


class ExperimentParams(Params):
    """Set in the launch file.

    ``training`` palpations per phantom and ring position of ``rings_mm``, ``trials`` of estimation per
    phantom. Order, re-homing and remounting were not published: ``training_order`` mixes the ring positions
    of a mounting (randomised) or goes through them in turn (blocked); ``rehome`` is before what the ring's
    actuator is driven to its stop and back (never: only as a policy wants it). ``swaps`` names policies that
    take over: ``30=nodes.policy_markov:Markov``. ``out``, the record's folder, must hold no session, unless
    that is to be replaced (``overwrite``).
    ``session`` names the session's sheet, which the report checks and copies.
    ``plan`` is the paper's experiment, or how well the rig repeats. ``depths`` and ``stop``: the estimator's.
    ``mounting``: which phantom when: ``grouped`` to limit remounts, ``each_trial``, ``block_randomised``, or
    a CSV of trials. ``specimens``: whether trials are of the phantoms of training, or of others.
    """

    out: str = "results"
    overwrite: bool = False
    session: str = ""
    plan: Literal["paper", "repeatability"] = "paper"
    wait_s: Seconds = 3600.0
    phantoms: str = ""
    policy: str = ""
    swaps: SwappedIn = ""
    seed: Count = 0
    trials: TrialCount = 100
    training: TrialCount = 25
    rings_mm: str = PUBLISHED
    training_order: Literal["randomised", "blocked"] = "randomised"
    rehome: Literal["palpation", "trial", "condition", "never"] = "trial"
    training_mounts: CountPositive = 1
    estimation_mounts: CountPositive = 1
    depths: DepthCount = 0
    stop: str = ""
    from_m: Metres = -0.03
    to_m: Metres = 0.05
    scene: str = ""
    mounting: ReadOnly[str] = GROUPED
    specimens: ReadOnly[Specimens] = "same"


class ExperimentState(RowFacts):
    """What a replacement inherits: the plan's replies so far, and the facts of the present step."""

    plan_seed: int = -1
    replies: list[str] = []
    trial_announced: bool = True
    label_m: float = 0.0
    iteration: int = 0
    commanded: bool = False
    swept: bool = False
    decided: bool = False
    goal_id: int = 0
    stage_ready: bool = True
    ring_trial: int = -1
    ring_iteration: int = -1
    ring_settled: bool = False
    rehomed: bool = False
    waited: bool = False
    palpation: list[Palpation] = []
    belief: list[Belief] = []
    palpations_done: int = 0
    right_count: int = 0
    judged: dict[str, list[int]] = {}
    trials_done: int = 0
    dropped_count: int = 0
    sweep_s: float = 0.0
    finished: bool = False
    again: list[tuple[int, str]] = []
    not_again: list[tuple[str, int]] = []
    mount_again: str = ""
    home_again: bool = False
    policy_changes: list[PolicyChange] = []


def classes_of(params: ExperimentParams) -> dict[str, float]:
    """Return the depth of each phantom that has a bead, by code."""
    phantoms = load_phantoms(params.phantoms)
    return {code: one.bead.depth_m for code, one in phantoms.items() if one.bead is not None}


def believed(params: ExperimentParams) -> list[float]:
    """Return the depths that a belief is about, in its order."""
    depths: list[float] = grid_of(sorted({*classes_of(params).values()}), params.depths).tolist()
    return depths


def is_right(design: ExperimentDesign | RepeatDesign, estimate_m: float, depth_m: float) -> bool:
    """Return whether the true depth is, of all phantoms' depths, the nearest to the estimate."""
    depths_m = (
        (phantom.depth_m for phantom in design.phantoms) if isinstance(design, ExperimentDesign) else ()
    )
    return abs(min(depths_m, key=lambda d: abs(d - estimate_m), default=estimate_m) - depth_m) < 1e-9


def design_of(params: ExperimentParams) -> ExperimentDesign | RepeatDesign:
    """Return the numbers of the plan that the parameters name.

    Raises:
        PerceptionError: The estimator's stop rule cannot decide among so few depths.
    """
    depths_m = classes_of(params)
    if params.plan == "repeatability":
        first = next(iter(depths_m), None) or next(iter(load_phantoms(params.phantoms)))  # bare gel will do
        return RepeatDesign(first, wait_s=params.wait_s)
    if params.stop not in ("", AUTO) and params.trials:
        require_classes(params.stop, len(believed(params)))
    if params.trials and not params.training:
        raise PerceptionError("training is 0: trials have nothing to compare with; train, or have no trials")
    design = ExperimentDesign(
        phantoms=tuple(plan.PlannedPhantom(code, depth_m) for code, depth_m in depths_m.items()),
        specimens=params.specimens,
        rings_m=rings_of(params.rings_mm),
        repeats=params.training,
        trials_per_phantom=params.trials,
        order=params.training_order,
        rehome=params.rehome,
        training_mounts=params.training_mounts,
        estimation_mounts=params.estimation_mounts,
    )
    return ordered(design, params.mounting)


def find_mistakes(params: ExperimentParams, mistakes: Mistakes) -> None:
    """Add what is wrong with the experiment asked for, by parameter; under "" what concerns several."""
    find_file_mistakes(params, mistakes)
    if mistakes:
        return
    with mistakes.of("rings_mm"):
        rings_of(params.rings_mm)
    with mistakes.of(""):
        design_of(params)
    with mistakes.of("swaps"):
        plan.planned(params.swaps)
    if params.from_m == params.to_m:
        mistakes["to_m"] = f"from_m and to_m are both {params.to_m:g} m: a sweep needs a length"


def plan_of(design: ExperimentDesign | RepeatDesign, state: ExperimentState) -> plan.Plan:
    """Return a fresh plan; the same seed gives the same one. At its end comes what is to be done again."""
    if isinstance(design, RepeatDesign):
        return repeatability(design)
    return plan.experiment(design, np.random.default_rng(state.plan_seed), state.again)


def take_up_marked(
    state: ExperimentState, design: ExperimentDesign | RepeatDesign, folder: Path
) -> Iterator[str]:
    """See, as a trial is over, what is to be done again at the end of the plan; yield what is to be logged.

    Of a trial that was itself another one done again, that is noted.
    """
    first = _redone_by(state, design)
    try:
        if first is not None:
            note_redone(folder, ("estimation", first), state.number)
        known = {("estimation", trial) for trial, _ in state.again}
        marked = to_be_redone(folder, known | {*state.not_again})
        felt = {(row.phase, row.trial): row for row in read_rows(folder)} if marked else {}
    except PalpError as error:
        yield f"nothing is repeated: {error}"
        return
    for key in marked:
        phase, trial = key
        if key in felt and phase == "estimation" and isinstance(design, ExperimentDesign):
            state.again.append((trial, felt[key].phantom))
            yield f"trial {trial} will be repeated at the end"
        else:
            state.not_again.append(key)
            yield f"{phase} trial {trial} is marked and not repeated: only trials of estimation are"


def _redone_by(state: ExperimentState, design: ExperimentDesign | RepeatDesign) -> int | None:
    """Return which trial the one under way does again; None if it is one of the plan."""
    if isinstance(design, RepeatDesign):
        return None
    place = state.trial - design.training_count - design.trial_count
    return state.again[place][0] if place >= 0 else None


def begin_trial_again(state: ExperimentState, design: ExperimentDesign | RepeatDesign) -> None:
    """Let the trial under way begin again on devices that have started again, after an interruption.

    Raises:
        PerceptionError: The plan is about what stays on the rig, and nothing did.
    """
    if isinstance(design, RepeatDesign):
        raise PerceptionError(
            "plan:=repeatability measures what stays while nothing is touched: an interrupted one cannot go "
            "on with devices that have started again; start it again, too"
        )
    state.mount_again, state.home_again = state.code, design.rehome != "never"
    state.trial_announced = state.commanded = state.swept = state.decided = False
    state.stage_ready, state.ring_settled, state.ring_landed = True, False, True
    state.ring_trial = state.ring_iteration = -1
    state.palpation, state.belief, state.guards = [], [], []
    state.enter_ns = state.leave_ns = state.true_ring_m = None
    state.touch_changed = True


# how far it has come

_MOST_DEPTHS = 6


def progress_of(
    design: ExperimentDesign | RepeatDesign,
    state: ExperimentState,
    phase: str,
    now_ns: int,
) -> Progress:
    """Return how far a phase has come: palpations in training, trials afterwards."""
    if isinstance(design, RepeatDesign):
        return Progress(
            stamp_ns=now_ns,
            phase=phase,
            done_count=state.palpations_done,
            total_count=sweep_count(design),
            text="palpations",
            score=0.0,
            score_defined=False,
            busy_s=state.sweep_s,
        )
    judged_count = state.trials_done - state.dropped_count
    training = phase == "training"
    return Progress(
        stamp_ns=now_ns,
        phase=phase,
        done_count=state.palpations_done if training else state.trials_done,
        total_count=design.training_count if training else design.trial_count + len(state.again),
        text="palpations" if training else _trials_text(state),
        score=state.right_count / judged_count if judged_count else 0.0,
        score_defined=judged_count > 0,
        busy_s=state.sweep_s,
    )


def note_judged(state: ExperimentState, *, right: bool) -> None:
    """Count the trial that ended to its depth."""
    depth = f"{state.depth_m * 1e3:g} mm"
    before, of = state.judged.get(depth, [0, 0])
    state.judged[depth] = [before + right, of + 1]


def _trials_text(state: ExperimentState) -> str:
    """Return what is counted, and how many were right at each depth.

    Phantoms come in blocks: the share over all trials so far falls and rises with whose block it is.
    """
    if not 1 < len(state.judged) <= _MOST_DEPTHS:
        return "trials"
    counts = (
        f"{depth} {right} of {of}" for depth, (right, of) in sorted(state.judged.items(), key=_depth_mm)
    )
    return f"trials, right: {', '.join(counts)}"


def _depth_mm(entry: tuple[str, list[int]]) -> float:
    return float(entry[0].partition(" ")[0])
