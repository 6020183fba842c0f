"""What the experiment says of its trials and of its progress."""

from msgs.estimation import Belief
from msgs.experiment import Trial, TrialResult
from nodes.experiment_params import ExperimentState
from palp_core import Progress
from palp_core.palpation.session.plan import ExperimentDesign
from palp_core.palpation.session.plan_repeatability import RepeatDesign, sweep_count

_DEPTHS_TOLD = 6


def trial_of(state: ExperimentState, now_ns: int) -> Trial:
    """Return the trial that begins; of a trial of estimation nobody is told the depth."""
    training = state.phase == "training"
    return Trial(
        stamp_ns=now_ns,
        trial=state.trial,
        phase=state.phase,
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
    design: ExperimentDesign | RepeatDesign, state: ExperimentState, phase: str, now_ns: int
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
    training, phantom_count = phase == "training", len(design.phantoms)
    palpation_count = design.repeats * phantom_count * len(design.rings_m)
    return Progress(
        stamp_ns=now_ns,
        phase=phase,
        done_count=state.palpations_done if training else state.trials_done,
        total_count=palpation_count if training else design.trials_per_phantom * phantom_count,
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
