"""Which plan the experiment follows, from its parameters, and what it says of its trials and progress."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from msgs.estimation import Belief
from msgs.experiment import Trial, TrialResult
from nodes.experiment_params import ExperimentParams, ExperimentState
from palp_core import Progress
from palp_core.errors import MethodError, PalpError, PerceptionError
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.stopping import require_classes
from palp_core.palpation.perception.belief.trial_filter import classes_of as grid_of
from palp_core.palpation.perception.strategy.trained_rings import rings_of
from palp_core.palpation.session import plan
from palp_core.palpation.session.audit import note_redone, to_be_redone
from palp_core.palpation.session.method_choices import AUTO
from palp_core.palpation.session.named_files import file_mistakes
from palp_core.palpation.session.orders import ordered
from palp_core.palpation.session.plan import ExperimentDesign
from palp_core.palpation.session.plan_repeatability import RepeatDesign, repeatability, sweep_count
from palp_core.palpation.session.trials_csv import read_rows


def classes_of(params: ExperimentParams) -> dict[str, float]:
    """Return the depth of each phantom that has a bead, by code."""
    phantoms = load_phantoms(params.phantoms)
    return {code: one.bead.depth_m for code, one in phantoms.items() if one.bead is not None}


def believed(params: ExperimentParams) -> list[float]:
    """Return the depths that a belief is about, in its order."""
    depths: list[float] = grid_of(sorted({*classes_of(params).values()}), params.depths).tolist()
    return depths


def is_right(design: plan.ExperimentDesign | RepeatDesign, estimate_m: float, depth_m: float) -> bool:
    """Tell whether the true depth is, of all phantoms' depths, the nearest to the estimate."""
    depths_m = (
        (phantom.depth_m for phantom in design.phantoms) if isinstance(design, plan.ExperimentDesign) else ()
    )
    return abs(min(depths_m, key=lambda d: abs(d - estimate_m), default=estimate_m) - depth_m) < 1e-9


def design_of(params: ExperimentParams) -> plan.ExperimentDesign | RepeatDesign:
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
    design = plan.ExperimentDesign(
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


def mistakes(params: ExperimentParams) -> dict[str, str]:
    """Return what is wrong with the experiment asked for, by parameter; "" for what concerns several."""
    if found := file_mistakes(params):
        return found
    checks: tuple[tuple[str, Callable[[], object]], ...] = (
        ("rings_mm", lambda: rings_of(params.rings_mm)),
        ("", lambda: design_of(params)),
        ("swaps", lambda: plan.planned(params.swaps)),
    )
    for name, check in checks:
        try:
            check()
        except (MethodError, PerceptionError, ValueError) as error:
            if str(error) not in found.values():
                found[name] = str(error)
    if params.from_m == params.to_m:
        found["to_m"] = f"from_m and to_m are both {params.to_m:g} m: a sweep needs a length"
    return found


def plan_of(design: plan.ExperimentDesign | RepeatDesign, state: ExperimentState) -> plan.Plan:
    """Return a fresh plan; the same seed gives the same one. At its end comes what is to be done again."""
    if isinstance(design, RepeatDesign):
        return repeatability(design)
    return plan.experiment(design, np.random.default_rng(state.plan_seed), state.again)


def take_up_marked(
    state: ExperimentState, design: plan.ExperimentDesign | RepeatDesign, folder: Path
) -> Iterator[str]:
    """See, as a trial is over, what is to be done again at the end of the plan; yield what is to be said.

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
        yield f"nothing is done again: {error}"
        return
    for key in marked:
        phase, trial = key
        if key in felt and phase == "estimation" and isinstance(design, ExperimentDesign):
            state.again.append((trial, felt[key].phantom))
            yield f"trial {trial} is done again at the end"
        else:
            state.not_again.append(key)
            yield f"{phase} trial {trial} is marked and not done again: only trials of estimation are"


def _redone_by(state: ExperimentState, design: plan.ExperimentDesign | RepeatDesign) -> int | None:
    """Return which trial the one under way does again; None if it is one of the plan."""
    if isinstance(design, RepeatDesign):
        return None
    place = state.trial - design.training_count - design.trial_count
    return state.again[place][0] if place >= 0 else None


def begin_trial_again(state: ExperimentState, design: ExperimentDesign | RepeatDesign) -> None:
    """Let the trial under way begin again on devices that have begun anew, after an interruption.

    Raises:
        PerceptionError: The plan is about what stays on the rig, and nothing did.
    """
    if isinstance(design, RepeatDesign):
        raise PerceptionError(
            "plan:=repeatability measures what stays while nothing is touched: an interrupted one cannot go "
            "on with devices that have begun anew; begin it anew, too"
        )
    state.mount_again, state.home_again = state.code, design.rehome != "never"
    state.trial_announced = state.commanded = state.swept = state.decided = False
    state.stage_ready, state.ring_settled, state.ring_landed = True, False, True
    state.ring_trial = state.ring_iteration = -1
    state.palpation, state.belief, state.guards = [], [], []
    state.enter_ns = state.leave_ns = state.true_ring_m = None
    state.touch_changed = True


# what it says of its trials and of its progress

_DEPTHS_TOLD = 6


def trial_of(state: ExperimentState, now_ns: int) -> Trial:
    """Return the trial that begins; of a trial of estimation nobody is told the depth."""
    training = state.phase == "training"
    return Trial(
        stamp_ns=now_ns,
        trial=state.trial,
        phase=state.phase,
        number=state.number,
        code=state.code if training else "",
        label_known=training,
        depth_m=state.label_m if training else 0.0,
    )


def result_of(state: ExperimentState, belief: Belief, now_ns: int) -> TrialResult:
    """Return what a trial of estimation came to."""
    return TrialResult(
        stamp_ns=now_ns,
        trial=state.trial,
        estimate_m=belief.estimate_m,
        confidence=belief.confidence,
        probe_count=belief.iteration,
        verdict=belief.verdict,
    )


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
    if not 1 < len(state.judged) <= _DEPTHS_TOLD:
        return "trials"
    told = (f"{depth} {right} of {of}" for depth, (right, of) in sorted(state.judged.items(), key=_depth_mm))
    return f"trials, right: {', '.join(told)}"


def _depth_mm(entry: tuple[str, list[int]]) -> float:
    return float(entry[0].partition(" ")[0])
